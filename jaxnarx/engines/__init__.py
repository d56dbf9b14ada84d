"""Virtual test beds: simulated engines that stand in for measured ones."""

from jaxnarx.engines.diesel import Diesel as Diesel
from jaxnarx.engines.engine import AbstractEngine as AbstractEngine
from jaxnarx.engines.gtdi import Gtdi as Gtdi
from jaxnarx.engines.gtdi import gtdi_records as gtdi_records
from jaxnarx.engines.pfi import Drive as Drive
from jaxnarx.engines.pfi import Pfi as Pfi
from jaxnarx.engines.pfi import Quantities as Quantities
from jaxnarx.engines.records import pfi_siso_records as pfi_siso_records
from jaxnarx.engines.vct import Vct as Vct
