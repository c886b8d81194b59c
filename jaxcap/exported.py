"""Programs for processes without jaxcap; see `jaxcap.batch.exported`, where it lives."""

from jaxcap.batch.exported import PLATFORMS as PLATFORMS
from jaxcap.batch.exported import export as export
from jaxcap.batch.exported import export_contacts as export_contacts
