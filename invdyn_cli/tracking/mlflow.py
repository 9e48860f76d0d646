"""Runs in MLflow: a local folder, or a server."""

import os
import re
import time
from dataclasses import dataclass

from invdyn_cli.tracking.contract import AbstractTracker, Tracked

MOST_PARAMS, MOST_METRICS, LONGEST = 100, 1000, 500
"""Entries of one request, and characters of a parameter, that MLflow takes at most."""


@dataclass(frozen=True)
class Mlflow(AbstractTracker):
    """Parameters, metrics, losses by epoch, figures and report of a run.

    Attributes:
        uri: tracking URI: a local folder, or http://HOST:PORT of a server.
        experiment: name of the MLflow experiment that the runs belong to.
    """

    uri: str = "outputs/mlruns"
    experiment: str = "invdyn"

    library = "mlflow"
    extra = "mlflow"

    def track(self, run: Tracked) -> None:
        """One MLflow run, finished at once."""
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")  # a folder is what mlflow-skinny can write to
        from mlflow import MlflowClient
        from mlflow.entities import Metric, Param

        client = MlflowClient(tracking_uri=self.uri)
        known = client.get_experiment_by_name(self.experiment)
        experiment = known.experiment_id if known else client.create_experiment(self.experiment)
        made = client.create_run(experiment, run_name=run.name).info.run_id
        now = int(1000 * time.time())
        params = [Param(_key(name), value[:LONGEST]) for name, value in run.params.items()]
        metrics = [Metric(_key(name), value, now, 0) for name, value in run.metrics.items()]
        for name, curve in run.losses.items():
            metrics += [Metric(_key(name), float(x), now, epoch) for epoch, x in enumerate(curve)]
        for k in range(0, len(params), MOST_PARAMS):
            client.log_batch(made, params=params[k : k + MOST_PARAMS])
        for k in range(0, len(metrics), MOST_METRICS):
            client.log_batch(made, metrics=metrics[k : k + MOST_METRICS])
        for path in run.files:
            client.log_artifact(made, str(path), "figures" if path.suffix != ".html" else None)
        client.set_terminated(made)


def _key(name: str) -> str:
    """A name of the characters that MLflow takes."""
    return re.sub(r"[^\w\-. /]", "_", name)
