"""Settings that an output belongs to, as JSON holds them: what is begun with some is not gone on with under others."""

from collections.abc import Mapping
from typing import Any


def differences(settings: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """Names of the settings that differ, or that only one of the two has."""
    return [name for name in {**settings, **found} if settings.get(name) != found.get(name)]
