from cosim.api.functions import component as component
from cosim.api.results import RunResult as RunResult
from cosim.api.running import check as check
from cosim.api.running import compare as compare
from cosim.api.running import open as open
from cosim.api.running import run as run
from cosim.api.running import sweep as sweep
from cosim.base.errors import CosimError as CosimError

__version__: str
