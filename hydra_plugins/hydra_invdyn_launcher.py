"""hydra/launcher=vmapped and hydra/sweeper=grid, the defaults of `invdyn run -m`: jobs that can be are fitted in one
program, and their files are written on all cores.

They stand here because Hydra takes plugins of the package `hydra_plugins` alone. Hydra imports this file at the start
of every command, so that it imports nothing heavy.
"""

import copy
import gc
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, configure_log, run_job, setup_globals
from omegaconf import DictConfig, open_dict

if TYPE_CHECKING:
    from invdyn_cli.verbs.together import Job


class Vmapped(BasicLauncher):
    """Fits what can be fitted together; then runs one job after the other in this process, as Hydra's own does."""

    def launch(self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int) -> Sequence[JobReturn]:
        """Run the jobs of these overrides, numbered from `initial_job_idx` on."""
        from invdyn_cli.verbs import sweep, together

        assert self.config is not None and self.hydra_context is not None and self.task_function is not None
        setup_globals()
        configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)
        Path(str(self.config.hydra.sweep.dir)).mkdir(parents=True, exist_ok=True)
        numbered = enumerate(job_overrides, initial_job_idx)
        configs = {number: self._config(number, overrides) for number, overrides in numbered}
        jobs = [self._job(number, config) for number, config in configs.items()]
        done = []
        with sweep.writers() as writers, sweep.made(together.made(jobs, writers)):
            gc.freeze()  # what is there now stays to the end: no need to go through it again in every job
            for config in configs.values():
                done.append(
                    run_job(
                        hydra_context=self.hydra_context,
                        task_function=self.task_function,
                        config=config,
                        job_dir_key="hydra.sweep.dir",
                        job_subdir_key="hydra.sweep.subdir",
                    )
                )
                configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)
        return done

    def _config(self, number: int, overrides: Sequence[str]) -> DictConfig:
        """The config of a job, Hydra's own part included."""
        assert self.hydra_context is not None and self.config is not None
        config = self.hydra_context.config_loader.load_sweep_config(self.config, list(overrides))
        with open_dict(config):
            config.hydra.job.id = config.hydra.job.num = number
        return config

    def _job(self, number: int, config: DictConfig) -> "Job":
        """What the task will get, and the folder that it will write into."""
        from invdyn_cli.verbs.together import Job

        before = HydraConfig.instance().cfg
        try:
            HydraConfig.instance().set_config(config)
            folder = Path(config.hydra.sweep.dir, str(config.hydra.sweep.subdir))
            own = copy.deepcopy(config)
        finally:
            HydraConfig.instance().cfg = before
        with open_dict(own):
            del own["hydra"]
        return Job(number, own, config.hydra, folder)


class Grid(BasicSweeper):
    """Hydra's own sweeper, which composes the config of every job to see whether it can be; `Vmapped` composes all of
    them before the first one runs, and is left to it."""

    def validate_batch_is_legal(self, batch: Sequence[Sequence[str]]) -> None:
        """Compose the configs, if jobs run elsewhere."""
        if not isinstance(self.launcher, Vmapped):
            super().validate_batch_is_legal(batch)
