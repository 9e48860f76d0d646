"""What somebody meant who called an option, or a choice, by the name that it has elsewhere."""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from difflib import get_close_matches

OPTIONS = {
    "robot.path": ("urdf", "xacro", "description", "file", "filename"),
    "data.path": ("log", "file", "filename", "csv", "bag", "h5", "dataset"),
    "data.columns": ("map", "column_map", "mapping"),
    "'data.columns={tau: {unit: A}}'": ("units", "unit"),
    "data.rate": ("sample_rate", "sampling_rate", "frequency", "freq", "hz"),
    "data.filter_cutoff": ("filter", "cutoff", "lowpass"),
    "data.train_share": ("train_split", "split", "train_size"),
    "data.torque_lag": ("delay", "lag", "time_offset"),
    "robot.dofs": ("dof", "n_joints", "num_joints"),
    "model.learning_rate": ("lr", "step_size", "alpha"),
    "model.epochs": ("iterations", "steps", "n_epochs", "num_epochs", "max_epochs"),
    "model.hidden": ("layers", "hidden_layers", "hidden_sizes", "units", "width"),
    "model.batch_size": ("batch", "bs", "minibatch"),
    "model.seeds": ("members", "ensemble", "n_members"),
    "seed": ("random_seed", "random_state", "rng", "key"),
    "hydra.run.dir": ("output", "out", "outdir", "out_dir", "output_dir", "folder", "save_dir", "log_dir"),
}
"""Options, some with a value, and the last words of names that they are taken to have; of several that fit the first
is meant."""

CHOICES = {
    "model": {"ffnn": ("mlp", "nn", "net", "neural_network", "dnn"), "gpr": ("gp", "gaussian_process"),
              "gru": ("rnn", "lstm"), "pest": ("rigid_body", "rbd", "rnea", "least_squares", "linear", "ols"),
              "lagrangian_net": ("delan", "lnn"), "svr": ("svm",), "dbm": ("dynamic_bezier_map",)},
    "adaptation": {"batch": ("none", "off", "false"), "incremental": ("online", "finetune", "sgd")},
}  # fmt: skip
"""Choices of a group, and names that they have elsewhere."""

ALWAYS = ("data.path", "hydra.run.dir")
"""Options of every command, the first with another choice of data."""

MISSING = {("convert", "output"): "invdyn convert SOURCE OUT.h5", ("convert", "source"): "invdyn convert SOURCE OUT.h5"}
"""What to type where an option that a verb needs is not set, by verb and option."""

FLAGS = ("--help --hydra-help --version --cfg --resolve --package --run --multirun --shell-completion --config-path "
         "--config-name --config-dir --experimental-rerun --info")  # fmt: skip
"""Hydra's own; argparse takes beginnings of them, too."""

CHANNEL = re.compile(r"(?:data\.)?(?:columns\.)?(time|q|qd|qdd|tau|q_ref|q_link)\.(columns?|unit|sign)")
"""An entry of the column map, as `invdyn convert` takes it."""

LOGS = (".h5", ".hdf5", ".csv", ".tsv", ".txt", ".npz", ".mat", ".parquet", ".bag", ".mcap", ".db3")
URDFS = (".urdf", ".xacro")


def option(key: str, argv: Sequence[str], every: Iterable[str]) -> str:
    """What to type instead of an option that does not exist; "" if nothing is likely.

    Args:
        key: the name that was given, such as "robot.urdf" or "epochs".
        argv: the whole command line.
        every: the full names of all options that the command has.
    """
    group, _, last = key.rpartition(".")
    every = list(every)
    value = next((a.partition("=")[2] for a in argv if a.lstrip("+").startswith(f"{key}=")), "") or "…"
    for typed in argv:
        name, _, entry = typed.lstrip("+").partition("=")
        if name.startswith(key) and (of_channel := CHANNEL.fullmatch(name)):
            channel, field = of_channel.groups()
            return f"'data.columns={{{channel}: {{{field}: {entry}}}}}'"
    fitting = [name for name, words in OPTIONS.items() if last in words]
    if not group and not get_close_matches(last, [name for name in every if "." not in name]):
        alike = [name for name in every if name.rpartition(".")[2] == last]
        fitting = sorted(alike, key=lambda name: value.endswith(URDFS) != name.startswith("robot")) + fitting
    for name in fitting:
        of = name.strip("'").partition("=")[0]
        if of.startswith(f"{group}." if group else "") and (of in every or of in ALWAYS):
            return name if "=" in name else _typed(name, value, argv, every)
    return ""


def flags(argv: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """What has dashes in front and is none of Hydra's own: as typed, as the name of an option, and its value or ""."""
    for flag, behind in itertools.zip_longest(argv, argv[1:], fillvalue=""):
        name, equals, value = flag.partition("=")
        if not name.startswith("--") or name == "--" or any(known.startswith(name) for known in FLAGS.split()):
            continue
        yield name, name[2:].replace("-", "_"), value if equals or behind[:1] == "-" or "=" in behind else behind


def choice(group: str, wanted: str, choices: Iterable[str]) -> str:
    """What to type instead of group=wanted, which is no choice; "" if nothing is likely."""
    if wanted.lower().endswith(URDFS if group == "robot" else LOGS if group == "data" else ()):
        return f"{'robot=urdf robot' if group == 'robot' else 'data=real_log data'}.path={wanted}"
    named = CHOICES.get(group, {})
    return next((f"{group}={name}" for name, words in named.items() if wanted in words and name in choices), "")


def of_file(name: str) -> str:
    """The option that a bare path belongs to, with its =."""
    return "robot.path=" if name.endswith(URDFS) else "data.path="


def _typed(name: str, value: str, argv: Sequence[str], every: Sequence[str]) -> str:
    """name=value, with the choice of the group that has this option."""
    if name == "robot.path" and not any(a.startswith("robot=") for a in argv):
        return f"robot=urdf {name}={value}"
    if name == "data.path" and name not in every:
        return f"data=real_log {name}={value}"
    return f"{name}={value}"
