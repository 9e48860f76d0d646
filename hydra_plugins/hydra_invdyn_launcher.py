"""hydra/launcher=vmapped, the default of `invdyn run -m`: jobs that can be are fitted in one program.

It stands here because Hydra takes launchers of the package `hydra_plugins` alone. Hydra imports this file at the start
of every command, so that it imports nothing heavy.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, setup_globals
from omegaconf import open_dict

if TYPE_CHECKING:
    from invdyn_cli.verbs.together import Job


class Vmapped(BasicLauncher):
    """Fits what can be fitted together; then runs one job after the other in this process, as Hydra's own does."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs of these overrides, numbered from `initial_job_idx` on."""
        from invdyn_cli.verbs import sweep, together

        before = HydraConfig.instance().cfg
        try:
            jobs = [self._job(initial_job_idx + i, overrides) for i, overrides in enumerate(job_overrides)]
        finally:
            HydraConfig.instance().cfg = before
        with sweep.prepared(together.fitted(jobs)):
            return super().launch(job_overrides, initial_job_idx)

    def _job(self, number: int, overrides: Sequence[str]) -> "Job":
        """The config that the job will have, and its folder."""
        from invdyn_cli.verbs.together import Job

        assert self.hydra_context is not None and self.config is not None
        setup_globals()
        config = self.hydra_context.config_loader.load_sweep_config(self.config, list(overrides))
        with open_dict(config):
            config.hydra.job.id = config.hydra.job.num = number
            HydraConfig.instance().set_config(config)
            folder = Path(config.hydra.sweep.dir, str(config.hydra.sweep.subdir))
            del config["hydra"]
        return Job(number, config, folder)
