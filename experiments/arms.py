"""Arms that nobody tuned for: serial arms drawn at random, as URDF text and as robots."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from invdyn_cli.robots import load_urdf
from invdyn_cli.types import Robot


def random_robot(draw: np.random.Generator, joints: int, base_rpy: Sequence[float] | None = None) -> Robot:
    """The robot of `random_arm`, its base turned by roll, pitch and yaw [rad]."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(random_arm(draw, joints))
        return load_urdf(path, base_rpy=base_rpy)


def random_arm(draw: np.random.Generator, joints: int) -> str:
    """URDF of an arm of revolute joints: links of 0.1 to 0.4 m that get lighter outwards, most axes across the link
    before them, centres of mass a little off, velocity limits 2 to 3.5 rad/s."""
    text = ['<robot name="random_arm">', '<link name="base"/>']
    mass = draw.uniform(4.0, 9.0)
    length = draw.uniform(0.15, 0.35)
    axis = np.array([0.0, 0.0, 1.0])
    for i in range(1, joints + 1):
        parent = "base" if i == 1 else f"link{i - 1}"
        xyz = (0, 0, 0.1) if i == 1 else np.round([*(0.04 * draw.uniform(-1, 1, 2)), length], 4)
        length = draw.uniform(0.1, 0.4) if i < joints else draw.uniform(0.08, 0.15)
        lower, upper = np.round([-draw.uniform(1.6, 2.8), draw.uniform(1.6, 2.8)], 3)
        com = np.round([*(0.1 * length * draw.uniform(-1, 1, 2)), length * draw.uniform(0.35, 0.6)], 4)
        radius = draw.uniform(0.04, 0.07)
        across = mass * (3 * radius**2 + length**2) / 12 * draw.uniform(0.8, 1.2)
        along = mass * radius**2 / 2 * draw.uniform(0.8, 1.2)
        rpy = np.round(0.3 * draw.uniform(-1, 1, 3), 3) if draw.random() < 0.3 else (0, 0, 0)
        text.append(
            f'<link name="link{i}"><inertial><origin xyz="{_text(com)}" rpy="{_text(rpy)}"/><mass value="{mass:.4f}"/>'
            f'<inertia ixx="{across:.6f}" ixy="0" ixz="0" iyy="{across * 1.05:.6f}" iyz="0" izz="{along:.6f}"/>'
            f"</inertial></link>"
            f'<joint name="axis{i}" type="revolute"><parent link="{parent}"/><child link="link{i}"/>'
            f'<origin xyz="{_text(xyz)}"/><axis xyz="{_text(axis)}"/>'
            f'<limit lower="{lower}" upper="{upper}" velocity="{draw.uniform(2.0, 3.5):.3f}" effort="300"/></joint>'
        )
        mass *= draw.uniform(0.55, 0.85)
        axis = _next_axis(draw, axis)
    return "\n".join([*text, "</robot>"])


def _next_axis(draw: np.random.Generator, axis: np.ndarray) -> np.ndarray:
    """Mostly another axis than the last one; parallel axes (shoulder and elbow) now and then."""
    choices = np.eye(3)
    weights = np.where(choices @ axis > 0.5, 0.35 if axis[2] < 0.5 else 0.0, 1.0)
    return choices[draw.choice(3, p=weights / weights.sum())]


def _text(values) -> str:
    return " ".join(f"{float(x):g}" for x in values)
