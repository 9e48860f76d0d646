"""The conformance checkers pass what keeps the contract, and name the rule that is broken where it does not."""

import itertools
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from invdyn_cli.interfaces import AbstractAdapter, AbstractModel, AbstractSource, silent
from invdyn_cli.testing import check_adapter, check_model, check_source
from invdyn_cli.types import Dataset, Fit, Motion, Splits, Trajectory
from tests.records import make_dataset, make_robot

COUNT = itertools.count()
DATA = replace(make_dataset(make_robot(("a", "b")), np.random.default_rng(0), samples=60), robot=None)


@dataclass(frozen=True)
class Linear(AbstractModel):
    """tau = gain qdd + offset, by the mean of a start that the key draws and the data: as small as a model can be."""

    needs_robot = False
    power: int = 2

    def init(self, dataset, key):
        n = len(dataset.joints)
        return {"gain": jax.random.normal(key, (n,)), "more": {"offset": jnp.zeros(n)}}

    def apply(self, params, motion, robot):
        return params["gain"] * motion.qdd + 0.1 * motion.q**self.power + params["more"]["offset"]

    def fit(self, dataset, key, *, validation=None, progress=silent):
        params = self.init(dataset, key)
        params = {**params, "more": {"offset": jnp.asarray(dataset.tau.mean(0))}}
        return Fit(params, dataset.robot, dataset.joints, 4)


def fitted(self, change, dataset, key):
    fit = Linear.fit(self, dataset, key)
    return replace(fit, params=change(fit.params))


def said(self, change, params, motion):
    return change(Linear.apply(self, params, motion, None))


BROKEN = {
    "is not a frozen dataclass": {"frozen": False},
    "cannot be hashed": {"field": [1]},
    "init gives list; allowed: a nested dict": {"init": lambda self, d, k: [1.0]},
    "holds float at 'gain'": {"init": lambda self, d, k: {"gain": 1.0}},
    "a key 'a/b'": {"init": lambda self, d, k: {"a/b": jnp.ones(2)}},
    "another structure or other shapes": {
        "fit": lambda self, d, k, **_: fitted(self, lambda p: {"gain": p["gain"]}, d, k)
    },
    "same key": {"fit": lambda self, d, k, **_: fitted(self, lambda p: p | {"gain": p["gain"] + next(COUNT)}, d, k)},
    "names the joints": {"fit": lambda self, d, k, **_: replace(Linear.fit(self, d, k), joints=("x", "y"))},
    "has history 'loss'": {
        "fit": lambda self, d, k, **_: replace(Linear.fit(self, d, k), history={"loss": np.zeros(3)})
    },
    r"gives \(2, 1\) for one sample": {"apply": lambda self, p, m, r: said(self, lambda x: x[:, None], p, m)},
    "not finite": {"apply": lambda self, p, m, r: said(self, lambda x: x / 0.0, p, m)},
    "under vmap differ": {"apply": lambda self, p, m, r: said(self, lambda x: x * (1 + next(COUNT)), p, m)},
    "computes two different things": {
        "apply": lambda self, p, m, r: said(self, lambda x: x * (1 + 1e-9 * next(COUNT)), p, m)
    },
    "gradient in its motion at rest": {"apply": lambda self, p, m, r: said(self, lambda x: x + jnp.sqrt(m.q**2), p, m)},
    "gradient in its parameters gives a slope": {
        "apply": lambda self, p, m, r: Linear.apply(self, jax.lax.stop_gradient(p), m, r)
    },
    "gradient in its motion gives a slope": {
        "apply": lambda self, p, m, r: Linear.apply(self, p, jax.lax.stop_gradient(m), r)
    },
    "predict and apply on every sample differ": {"predict": lambda self, f, m: 1.01 * Linear().predict(f, m)},
    "predict gives .*; allowed: a numpy array": {"predict": lambda self, f, m: jnp.asarray(Linear().predict(f, m))},
    "the mean over its 2 members": {
        "members": lambda self, f: (f, replace(f, params=jax.tree.map(lambda x: x + 1, f.params)))
    },
    "cannot be saved and loaded again: the trusted module .* has no dataclass": {},
}  # fmt: skip


def broken(changes: dict) -> AbstractModel:
    """A Linear that differs in one way."""
    methods = {name: change for name, change in changes.items() if callable(change)}
    if "field" in changes:
        methods |= {"__annotations__": {"extra": object}, "extra": None}
    kind = type("Broken", (Linear,), methods)
    if changes.get("frozen") is False:
        return kind.__new__(type("Thawed", (kind,), {"__dataclass_params__": replaced_params()}))
    kind = dataclass(frozen=True)(kind)
    return kind(extra=changes["field"]) if "field" in changes else kind()


def replaced_params():
    @dataclass
    class Plain:
        pass

    return Plain.__dataclass_params__


def test_a_good_model_passes():
    """The smallest honest model passes, with any key."""
    check_model(Linear(), DATA)
    check_model(Linear(3), DATA, key=jax.random.key(5))


@pytest.mark.parametrize("words", BROKEN)
def test_a_broken_model_is_named(words):
    """Each way to break the contract raises an AssertionError that says which rule it is."""
    with pytest.raises(AssertionError, match=words):
        check_model(broken(BROKEN[words]), DATA)


@dataclass(frozen=True)
class Offset(AbstractAdapter):
    """The fitted model plus a running mean of its error."""

    rate: float = 0.1

    def fit(self, model, dataset, key, *, validation=None, progress=silent):
        return model.fit(dataset, key, validation=validation, progress=progress)

    def init(self, model, fit):
        return {"params": fit.params, "offset": jnp.zeros(len(fit.joints)), "seen": jnp.zeros((), int)}

    def predict(self, model, state, motion):
        return model.apply(state["params"], motion, None) + state["offset"]

    def update(self, model, state, motion, tau):
        error = tau - self.predict(model, state, motion)
        return {**state, "offset": state["offset"] + self.rate * error, "seen": state["seen"] + 1}


def grown(self, model, state, motion, tau):
    return {**state, "offset": jnp.append(state["offset"], 0.0)}


def in_place(self, model, state, motion, tau):
    state["offset"] = state["offset"] + 1
    return state


BROKEN_ADAPTERS = {
    "before any update and the fitted model differ": {"predict": lambda s, m, x, y: Offset.predict(s, m, x, y) + 100.0},
    r"gives \(\) for one sample": {"predict": lambda s, m, x, y: Offset.predict(s, m, x, y).sum()},
    "changes the structure, a shape or a type": {"update": grown},
    "changes the state that it is given": {"update": in_place},
    "update called twice": {"update": lambda s, m, x, y, t: {**x, "offset": x["offset"] + next(COUNT)}},
    "not finite within": {"update": lambda s, m, x, y, t: {**x, "offset": x["offset"] / 0.0}},
}


def test_a_good_adapter_passes():
    """An adapter that learns an offset passes."""
    check_adapter(Offset(), Linear(), DATA)


@pytest.mark.parametrize("words", BROKEN_ADAPTERS)
def test_a_broken_adapter_is_named(words):
    """Each way to break the contract raises an AssertionError that says which rule it is."""
    kind = dataclass(frozen=True)(type("Broken", (Offset,), BROKEN_ADAPTERS[words]))
    with pytest.raises(AssertionError, match=words):
        check_adapter(kind(), Linear(), DATA)


@dataclass(frozen=True)
class Made(AbstractSource):
    """Three random trajectories, a set each, one thing about them being `wrong`."""

    needs_robot = False
    wrong: str = ""

    def load(self, robot, progress=silent):
        rng = np.random.default_rng(next(COUNT) if self.wrong == "new" else 0)
        t = np.arange(20) / 10
        sets = []
        for name in "abc":
            q, qd, qdd, tau = rng.normal(size=(4, 20, 2))
            sets.append([name, t, q, qd, qdd, tau])
        if self.wrong == "leak":
            sets[2] = [x if i == 0 else np.concatenate([x, sets[0][i][-3:] + 0.0]) for i, x in enumerate(sets[2])]
            sets[2][1][-3:] = sets[0][1][-3:]
        if self.wrong == "backwards":
            sets[1][1] = t[::-1]
        if self.wrong == "nan":
            sets[2][4][3, 1] = np.nan
        if self.wrong == "shape":
            sets[0][5] = sets[0][5][:-1]
        made = [
            Dataset((Trajectory(name, t, Motion(q, qd, qdd), tau),), ("a", "b") if self.wrong != name else ("a", "x"))
            for name, t, q, qd, qdd, tau in sets
        ]
        progress(2.0 if self.wrong == "progress" else 1.0, "made")
        words = {"at": t} if self.wrong == "words" else {"at": "random"}
        return Splits(made[0], made[1], {"other" if self.wrong == "untested" else "test": made[2]}, words)


BROKEN_SOURCES = {
    "new": "gives other data when called again",
    "leak": "clock does not run forward|train and test share 3 samples",
    "backwards": "validation, b: the clock does not run forward",
    "nan": "test, c: qdd has numbers that are not finite",
    "shape": r"train, a: tau has shape \(19, 2\); required: \(20, 2\)",
    "c": r"test has joints \('a', 'x'\)",
    "progress": "outside 0 to 1",
    "untested": "required: 'test'",
    "words": "cannot be written as JSON",
}


def test_a_good_source_passes():
    """Three sets of random numbers pass, without a robot."""
    check_source(Made(), None)


@pytest.mark.parametrize("wrong", BROKEN_SOURCES)
def test_a_broken_source_is_named(wrong):
    """Each way to break the contract raises an AssertionError that says which rule it is."""
    with pytest.raises(AssertionError, match=BROKEN_SOURCES[wrong]):
        check_source(Made(wrong), None)
