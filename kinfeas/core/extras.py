"""Optional packages, and the extras of the installation that contain them."""

from importlib.util import find_spec

from kinfeas.core.errors import KinfeasError

EXTRAS = {
    "train": ("torch", "stable_baselines3", "gymnasium", "tensorboard", "sklearn", "threadpoolctl"),
    "export": ("onnx", "onnxruntime"),
    "pybullet": ("pybullet", "pybullet_utils"),
    "mujoco": ("mujoco",),
    "meshes": ("trimesh", "collada"),
    "xacro": ("xacro",),
    "plots": ("matplotlib", "mpl_toolkits", "PIL"),
    "view": ("viser",),
    "video": ("av",),
    "ros2": ("cyclonedds",),
    "bags": ("rosbags",),
    "qp": ("pinocchio", "pink", "qpsolvers", "daqp"),
    "ray": ("ray",),
    "sweep": ("optuna",),
    "wandb": ("wandb",),
    "lerobot": ("pyarrow",),
}
"""Names under which the packages of each extra are imported."""

_EXTRA_OF = {package: extra for extra, packages in EXTRAS.items() for package in packages}


def require(*packages: str) -> None:
    """Raise KinfeasError, which names the extras, unless all the packages are installed."""
    if missing := [package for package in packages if find_spec(package) is None]:
        raise KinfeasError(_text(missing))


def missing_extra(error: BaseException) -> str | None:
    """Return the message for a failed import of an optional package; None for other errors."""
    package = (getattr(error, "name", None) or "").partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or package not in _EXTRA_OF:
        return None
    return _text([package])


def _text(packages: list[str]) -> str:
    extras = ",".join(dict.fromkeys(_EXTRA_OF[package] for package in packages))
    return f"{', '.join(packages)} not installed: pip install 'kinfeas[{extras}]'"
