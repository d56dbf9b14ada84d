"""The turbocharged direct-injection engine: bed, components, operation and limits."""

from jaxnarx.engines.gtdi.bed import Gtdi
from jaxnarx.engines.gtdi.records import (
    Breaches,
    breaches,
    gtdi_records,
    operate,
    scheduled,
)

__all__ = ["Breaches", "Gtdi", "breaches", "gtdi_records", "operate", "scheduled"]
