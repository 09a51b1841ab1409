"""System identification: robots from records of runs, and the runs that excite and record them."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from kinfeas.api import DEFAULT_ROBOT, Name
from kinfeas.api.deploy import Deployment, make_setup, recorded
from kinfeas.api.load import checked, load_robot, read_adapters, text_of
from kinfeas.config import Settings, nested, strict_yaml
from kinfeas.config.recipes import default_engine, load_section
from kinfeas.control.assemble import build_backend, with_adapters
from kinfeas.core.errors import KinfeasError
from kinfeas.core.files import check_new, is_bag, write_file
from kinfeas.core.quantities import Rate, Seed
from kinfeas.io.run_log import Moment, read_record
from kinfeas.kinematics.ik import IkSolver
from kinfeas.sim2real.adapters.noise import Localisation
from kinfeas.sim2real.deploy.config import DeployConfig
from kinfeas.sim2real.identify.bags import read_bag
from kinfeas.sim2real.identify.excitation import SECONDS, Excitation
from kinfeas.sim2real.identify.fit import ResponseFit, fit
from kinfeas.sim2real.identify.log import log_of

_LEAST = 2e-3  # smaller parameters of a response are left out of `response_lines`
_UNUSED = {  # settings of `DeployConfig` without effect on the pattern
    "arm_settle_timeout", "filters", "generator", "grasp_settle_time", "head_start",
    "head_start_jitter", "task", "time_scale",
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Identified(ResponseFit):
    """A robot identified from records."""

    robot: str  # its name, or the path of its YAML
    records: tuple[str, ...]  # files of the records

    @property
    def response_lines(self) -> str:
        """The response as a section of `robot.yaml`."""
        measured = {
            name: float(f"{value:.3g}")
            for name, value in asdict(self.response).items()
            if value is not None and value >= _LEAST
        }
        return strict_yaml.to_text({"response": measured})

    @property
    def adapter_lines(self) -> str:
        """The adapters as a file for `--adapters`."""
        lines = [f"# {self.robot}, identified from {len(self.records)} record(s); from the robot "
                 "outwards."]  # fmt: skip
        lines += [f"# {sentence[0].upper()}{sentence[1:]}." for sentence in self.missing]
        lines.append("adapters:")
        for spec in self.adapters:
            own = f", parameters: {strict_yaml.to_line(spec.parameters)}" if spec.parameters else ""
            lines.append(f"  - {{name: {spec.name}{own}}}")
        return "\n".join(lines) + "\n"

    def facts(self) -> dict[str, object]:
        """Return the results as plain data."""
        return {
            "robot": self.robot,
            "records": list(self.records),
            "estimates": {
                name: {key: float(value) for key, value in asdict(estimate).items()}
                for name, estimate in self.estimates.items()
            },
            "response": asdict(self.response),
            "adapters": [spec.entry() for spec in self.adapters],
            "missing": list(self.missing),
        }


def identify(
    records: Name | Sequence[Name],
    robot: Name | None = None,
    *,
    out: Name | None = None,
    picture: Name | None = None,
    prior: Name = "harsh",
) -> Identified:
    """Fit a robot's response and noise to records of its runs, and return it.

    Example: `kinfeas.identify("run.csv", out="my_robot.yaml").response.base_lag`

    Args:
        records: Records of one robot, from `kinfeas deploy` or `drive`, or ROS bags.
        robot: Robot; that of the first record by default. ROS bags need it.
        out: New YAML file of adapters.
        picture: PNG file to write, of measured and predicted velocities.
        prior: List of adapters from which the drift of the localisation is taken, since measured
            poses do not tell drift from base noise.

    Raises:
        KinfeasError: If a record is invalid, of another robot, or shows no motion.
    """
    if isinstance(records, str) or not isinstance(records, Sequence):
        records = [records]
    paths = [Path(text_of(record, "records")) for record in records]
    if not paths:
        raise KinfeasError("give at least one record")
    if out is not None and Path(text_of(out, "out")).suffix not in (".yaml", ".yml"):
        raise KinfeasError(f"{out}: must end in .yaml")
    check_new(out)
    drift = _drift(prior)
    runs = [None if is_bag(path) else read_record(path) for path in paths]
    if robot is None:
        if runs[0] is None:
            raise KinfeasError(f"{paths[0]}: a bag needs the name of its 'robot'")
        robot = runs[0].about.robot
    name = str(robot)
    model = load_robot(name)
    logs = [
        read_bag(path, model) if run is None else log_of(run, model, str(path))
        for path, run in zip(paths, runs, strict=True)
    ]
    periods = sorted({log.dt for log in logs})
    if len(periods) > 1:
        raise KinfeasError(f"records with different control periods: {periods} s")
    result = Identified(**vars(fit(logs, drift)), robot=name, records=tuple(map(str, paths)))
    if out is not None:
        write_file(Path(out), result.adapter_lines.encode())
    if picture is not None:
        from kinfeas.viz.plots import velocities_figure
        from kinfeas.viz.style import png

        write_file(Path(picture), png(velocities_figure(result)))
    return result


def _drift(prior: Name) -> tuple[float, float]:
    """Return the localisation's drift in a list of adapters, m and rad after 1 s; 0 without one."""
    for spec in read_adapters(prior):
        if spec.name == "localisation":
            world = build_backend("analytic", {})
            adapter = with_adapters(world, (spec,), load_robot(DEFAULT_ROBOT))
            assert isinstance(adapter, Localisation)
            return adapter.mean("drift"), adapter.mean("turn_drift")
    return 0.0, 0.0


def drive(  # noqa: PLR0913 - options of the command
    robot: Name = DEFAULT_ROBOT,
    *,
    backend: str | None = None,
    record: Name | None = None,
    adapters: Name | None = None,
    rate: float = 50.0,
    seed: int = 0,
    real_time: bool = True,
    settings: Settings | None = None,
    on_moment: Callable[[Moment], None] | None = None,
) -> Deployment:
    """Drive a robot through the excitation of a minute for `identify`, and return the run.

    The guards are those of `kinfeas.deploy`, and `settings` are values by key of `DeployConfig`.
    Adapters are part of the simulated robot here: they act between the guards and the backend.

    Raises:
        KinfeasError: If an argument or a setting is invalid, or the run cannot start.
    """
    dt = 1.0 / checked(Rate, rate, "rate")
    model, backend = load_robot(robot), backend or default_engine()
    config = load_section(DeployConfig, "deploy", model.folder, settings)
    if unused := sorted(_UNUSED & nested(settings).keys()):
        raise KinfeasError(f"{unused[0]!r} has no effect on the pattern")
    config = replace(config, filters=(), arm_settle_timeout=0.0)
    specs = read_adapters(adapters)
    excitation = Excitation(IkSolver(model, config.ik), dt)
    setup = make_setup(
        "stationary", model, backend, excitation, config, record, rate=rate, seconds=SECONDS,
        seed=checked(Seed, seed, "seed"), real_time=real_time, inner=specs,
        leading=(excitation,),
    )  # fmt: skip
    return recorded(
        setup, text_of(robot, "robot"), "stationary", backend, record, on_moment, adapters=specs
    )
