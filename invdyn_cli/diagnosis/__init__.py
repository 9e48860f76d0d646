"""From a measured log to the effects that its simulation lacks: `diagnose(log, robot)`."""

from invdyn_cli.diagnosis.case import Options
from invdyn_cli.diagnosis.pipeline import diagnose

__all__ = ["Options", "diagnose"]
