"""Virtual test beds: simulated engines that stand in for measured ones."""

from collections.abc import Callable, Mapping

from jaxnarx.engines._family import family as family
from jaxnarx.engines._family import family_run as family_run
from jaxnarx.engines._records import pfi_siso_records as pfi_siso_records
from jaxnarx.engines._records import records as records
from jaxnarx.engines.bench import Noise as Noise
from jaxnarx.engines.crossley_cook import CrossleyCook as CrossleyCook
from jaxnarx.engines.diesel import Diesel as Diesel
from jaxnarx.engines.engine import AbstractEngine as AbstractEngine
from jaxnarx.engines.engine import Borders as Borders
from jaxnarx.engines.engine import parameter as parameter
from jaxnarx.engines.gtdi import Gtdi as Gtdi
from jaxnarx.engines.integration import solve as solve
from jaxnarx.engines.pfi import Drive as Drive
from jaxnarx.engines.pfi import Pfi as Pfi
from jaxnarx.engines.pfi import Quantities as Quantities
from jaxnarx.engines.pfi_dyno import PfiDyno as PfiDyno
from jaxnarx.engines.vct import Vct as Vct
from jaxnarx.extensions import Registry

_OWN_BEDS: Mapping[str, Callable[[], AbstractEngine]] = {
    "pfi": Pfi,
    "pfi-dyno": PfiDyno,
    "pfi-cc": CrossleyCook,
    "diesel": Diesel,
    "gtdi": Gtdi,
    "vct": Vct,
}
BEDS: Registry[Callable[[], AbstractEngine]] = Registry("engine", _OWN_BEDS)
"""Every bed by its name on the command line."""
