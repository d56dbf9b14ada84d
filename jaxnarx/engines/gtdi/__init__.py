"""The turbocharged direct-injection engine: bed, components and operation."""

from jaxnarx.engines.gtdi.bed import Gtdi as Gtdi
from jaxnarx.engines.gtdi.operation import gtdi_demands as gtdi_demands
from jaxnarx.engines.gtdi.operation import operate as operate
from jaxnarx.engines.gtdi.operation import schedule_inputs as schedule_inputs
