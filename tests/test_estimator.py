"""Models as scikit-learn knows estimators: its own checks, cross-validation, pipelines, grid search."""

import sys
from dataclasses import dataclass

import numpy as np
import pytest

pytest.importorskip("sklearn", reason="scikit-learn is not installed: pip install 'invdyn[sklearn]'")
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, KFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer
from sklearn.utils.estimator_checks import parametrize_with_checks

import invdyn_cli as invdyn
from invdyn_cli.errors import UsageError
from invdyn_cli.estimator import InverseDynamicsRegressor
from invdyn_cli.interfaces import AbstractModel, silent
from invdyn_cli.registry import make_model
from invdyn_cli.robots import load_urdf, pinocchio_model
from invdyn_cli.types import Fit, Motion


@dataclass(frozen=True)
class Affine(AbstractModel):
    """tau = W [q, qd, qdd, 1], by least squares: a model that is fitted at once."""

    needs_robot = False
    ridge: float = 1e-6

    def init(self, dataset, key):
        return {"w": np.zeros((3 * len(dataset.joints) + 1, len(dataset.joints)))}

    def apply(self, params, motion, robot):
        return self.predict(Fit(params, None, (), 0), Motion(motion.q[None], motion.qd[None], motion.qdd[None]))[0]

    def fit(self, dataset, key, *, validation=None, progress=silent):
        x = self._rows(dataset.motion)
        w = np.linalg.solve(x.T @ x + self.ridge * np.eye(x.shape[1]), x.T @ dataset.tau)
        return Fit({"w": w}, None, dataset.joints, w.size)

    def predict(self, fit, motion):
        return self._rows(motion) @ fit.params["w"]

    def _rows(self, motion):
        return np.concatenate([motion.q, motion.qd, motion.qdd, np.ones((len(motion.q), 1))], axis=1)


class AnyColumns(InverseDynamicsRegressor):
    """Takes any number of columns: the first 3 n, or repeated ones. All that is left of scikit-learn's checks."""

    def _motion(self, X, n):
        return super()._motion(np.resize(X.T, (3 * n, len(X))).T if X.shape[1] < 3 * n else X[:, : 3 * n], n)

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.regressor_tags.poor_score = True  # it leaves out most of the columns that the checks make
        return tags


WHY = "the check has another number of columns than the 3 n of [q, qd, qdd], which are refused"
EXPECTED = dict.fromkeys(
    (
        "check_estimators_overwrite_params",
        "check_estimators_fit_returns_self",
        "check_readonly_memmap_input",
        "check_n_features_in_after_fitting",
        "check_positive_only_tag_during_fit",
        "check_estimators_dtypes",
        "check_dtype_object",
        "check_regressors_train",
        "check_regressor_data_not_an_array",
        "check_regressor_multioutput",
        "check_regressors_no_decision_function",
        "check_regressors_int",
        "check_fit2d_1sample",
        "check_fit2d_1feature",
        "check_fit_idempotent",
        "check_fit_check_is_fitted",
        "check_n_features_in",
    ),
    WHY,
)


def expected(estimator) -> dict[str, str]:
    """The checks that an estimator cannot pass, each with the reason."""
    return {} if isinstance(estimator, AnyColumns) else EXPECTED


@parametrize_with_checks(
    [InverseDynamicsRegressor(Affine()), AnyColumns(Affine())], expected_failed_checks=expected
)  # fmt: skip
def test_keeps_the_contract_of_scikit_learn(estimator, check):
    """All of scikit-learn's checks pass; without the rule on columns none is an exception."""
    check(estimator)


@pytest.fixture(scope="module")
def arm():
    """Two joints."""
    return load_urdf("apollo_arm", dofs=2)


@pytest.fixture(scope="module")
def data(arm):
    """X (200, 6) and y (200, 2): motions drawn at random, torques by Pinocchio, with Coulomb friction of 1 N m."""
    import pinocchio as pin

    q, qd, qdd = np.random.default_rng(0).uniform(-2, 2, (3, 200, 2))
    model = pinocchio_model(arm)
    memory = model.createData()
    rigid = np.array([pin.rnea(model, memory, *one).copy() for one in zip(q, qd, qdd, strict=True)])  # pyright: ignore
    return np.concatenate([q, qd, qdd], axis=1), rigid + np.sign(qd)


def test_grid_search_finds_the_friction(arm, data):
    """In a pipeline, GridSearchCV changes a hyperparameter by name; PEST predicts left-out rows with R^2 above
    0.99, but only with friction."""
    X, y = data
    model = make_model("pest", relative=True, threshold=1e-6)
    estimator = make_pipeline(FunctionTransformer(), InverseDynamicsRegressor(model, arm))
    name = "inversedynamicsregressor__model__friction"
    search = GridSearchCV(estimator, {name: ["none", "coulomb_viscous"]}, cv=KFold(2), refit=False, error_score="raise")
    assert search.fit(X, y).best_params_ == {name: "coulomb_viscous"}
    assert search.best_score_ > 0.99 > search.cv_results_["mean_test_score"][0]


def test_cross_validation_knows_a_linear_law(data):
    """Torques that are linear in the motion are predicted exactly on every left-out part."""
    X, _ = data
    y = X @ np.arange(12.0).reshape(6, 2) + 1
    np.testing.assert_allclose(cross_val_score(InverseDynamicsRegressor(Affine(ridge=0.0)), X, y, cv=5), 1, atol=1e-9)


def test_a_network_needs_no_robot(data):
    """A model by name and hyperparameters learns one joint from its own columns, y as a vector."""
    X, y = data[0][:, [0, 2, 4]], data[1][:, 0]
    estimator = InverseDynamicsRegressor(make_model("ffnn", epochs=3, hidden=[8])).fit(X, y)
    assert estimator.predict(X).shape == y.shape and np.isfinite(estimator.score(X, y))


def test_clones_are_equal_and_apart(arm):
    """A clone has the same hyperparameters; changing them leaves the original as it is."""
    estimator = InverseDynamicsRegressor("pest", arm)
    other = clone(estimator).set_params(model__threshold=np.float64(0.5))
    assert (other.model.threshold, estimator.get_params()["model__threshold"]) == (0.5, 1e-3)
    assert estimator.model == "pest" and other.robot.joints == arm.joints


def test_refuses_in_one_sentence(arm, data):
    """Other columns, a model without its robot, hyperparameters that there are not."""
    X, y = data
    for error, word, call in (
        (ValueError, "X has 5 columns for 2 joints; allowed: 6", lambda: _fit(X[:, :-1], y, arm)),
        (ValueError, "y has 1 columns; allowed: 2", lambda: _fit(X, y[:, :1], arm)),
        (UsageError, "the model Standard needs the robot", lambda: _fit(X, y, None)),
        (UsageError, "no option frction, did you mean 'friction'", lambda: _set(model__frction="none")),
        (ValueError, "Invalid parameter 'modl'", lambda: _set(modl="pest")),
    ):
        with pytest.raises(error, match=word):
            call()


def test_without_scikit_learn(monkeypatch):
    """Where scikit-learn is missing, one line says how to install it."""
    monkeypatch.setitem(sys.modules, "sklearn.base", None)
    monkeypatch.delitem(sys.modules, "invdyn_cli.estimator")
    with pytest.raises(UsageError, match=r"needs the library scikit-learn.*invdyn\[sklearn\]"):
        _ = invdyn.InverseDynamicsRegressor


def _fit(X, y, robot):
    return InverseDynamicsRegressor(robot=robot).fit(X, y)


def _set(**params):
    return InverseDynamicsRegressor("pest").set_params(**params)
