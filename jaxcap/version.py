"""The version, where the build reads it as well."""

__version__ = "0.2.0"
