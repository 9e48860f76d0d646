"""A model as an estimator of scikit-learn: fit, predict, score, clone, pipelines, cross-validation, grid search."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from invdyn_cli.errors import UsageError
from invdyn_cli.interfaces import AbstractModel
from invdyn_cli.registry import make_model
from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Dataset, Motion, Robot, Trajectory

try:
    from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as error:
    got = "InverseDynamicsRegressor needs the library scikit-learn"
    raise UsageError(got, advice='pip install "invdyn[sklearn]"') from error

NESTED = "model__"
"""Prefix of the hyperparameters of the model, as in GridSearchCV: model__threshold."""


class InverseDynamicsRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    """tau = f(q, qd, qdd) with X = [q, qd, qdd] (N, 3 n) [rad, rad/s, rad/s^2; m, …] and y = torque (N, n) [N m; N].

    `score` is scikit-learn's R^2, the mean over the joints of 1 - NMSE. Neighbouring samples of a log are alike: split
    it into stretches of time (`KFold` without shuffling), else scores are too good.

    Parameters:
        model: a name with default hyperparameters, or a model (`make_model("pest", offset=True)`). Its hyperparameters
            are parameters of the estimator too, called model__NAME.
        robot: a robot or the path of its URDF, for models that need one; its joints are the columns of y.
        seed: of everything random.

    Attributes:
        model_, fit_, robot_: the model, what it learned (`types.Fit`), and the robot, None without.
    """

    def __init__(
        self, model: str | AbstractModel = "standard", robot: Robot | str | Path | None = None, seed: int = 0
    ) -> None:
        self.model = model
        self.robot = robot
        self.seed = seed

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Parameters by name, with `deep` those of the model too."""
        own = super().get_params(deep=False)
        return own | {NESTED + name: x for name, x in self._hyperparameters().items()} if deep else own

    def set_params(self, **params: Any) -> "InverseDynamicsRegressor":
        """Change parameters; model__NAME makes another model object.

        Raises:
            UsageError: for a hyperparameter that the model does not have, or a value that is not allowed.
            ValueError: for a parameter that there is not.
        """
        nested = {name.removeprefix(NESTED): x for name, x in params.items() if name.startswith(NESTED)}
        super().set_params(**{name: x for name, x in params.items() if not name.startswith(NESTED)})
        if nested:
            self.model = make_model(make_model(self.model), **nested)
        return self

    def fit(self, X: Any, y: Any) -> "InverseDynamicsRegressor":
        """Learn from rows X (N, 3 n) and torques y (N, n), or (N,) of one joint.

        Raises:
            ValueError: for shapes that do not match, or values that are not finite.
            UsageError: if the model needs a robot and there is none.
        """
        X, y = validate_data(self, X, y, dtype=np.float64, multi_output=True, y_numeric=True)
        robot = load_urdf(self.robot) if isinstance(self.robot, str | Path) else self.robot
        model = make_model(self.model)
        if robot is None and model.needs_robot:
            advice = "robot='arm.urdf', or a model that needs no robot ('ffnn', 'dbm')"
            raise UsageError(f"the model {type(model).__name__} needs the robot's kinematics", advice=advice)
        tau = np.asarray(y, float).reshape(len(X), -1)
        joints = robot.joints if robot else tuple(f"joint_{j + 1}" for j in range(tau.shape[1]))
        if tau.shape[1] != len(joints):
            raise ValueError(f"y has {tau.shape[1]} columns; allowed: {len(joints)}, a torque for each joint")
        one = Trajectory("X", np.arange(len(X), dtype=float), self._motion(X, len(joints)), tau)
        dataset = Dataset((one,), joints, robot)
        self.model_, self.robot_, self._flat = model, robot, np.ndim(y) == 1
        self.fit_ = model.fit(dataset, jax.random.key(self.seed))
        return self

    def predict(self, X: Any) -> np.ndarray:
        """Torques (N, n) of rows X (N, 3 n), (N,) where y was.

        Raises:
            ValueError: for another number of columns, or values that are not finite.
        """
        check_is_fitted(self, "fit_")
        X = validate_data(self, X, dtype=np.float64, reset=False)
        tau = np.asarray(self.model_.predict(self.fit_, self._motion(X, len(self.fit_.joints))))
        return tau.ravel() if self._flat else tau

    def _motion(self, X: np.ndarray, n: int) -> Motion:
        """The columns of X as a motion of n joints."""
        if X.shape[1] != 3 * n:
            got = f"X has {X.shape[1]} columns for {n} joints"
            raise ValueError(f"{got}; allowed: {3 * n}, [q, qd, qdd] with a column for each joint")
        return Motion(*np.split(X, 3, axis=1))

    def _hyperparameters(self) -> Mapping[str, Any]:
        try:
            model = make_model(self.model)
        except UsageError:  # fit tells it
            return {}
        return {f.name: getattr(model, f.name) for f in fields(model) if f.init} if is_dataclass(model) else {}
