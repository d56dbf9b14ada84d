"""The turbocharged direct-injection engine: bed, components and operation."""

from jaxnarx.engines.gtdi.bed import Gtdi
from jaxnarx.engines.gtdi.operation import gtdi_demands, operate, scheduled

__all__ = ["Gtdi", "gtdi_demands", "operate", "scheduled"]
