"""Draft the robots of `kinfeas/robots` that vendors describe: `python studies/zoo.py fetch`.

The folder of `--sources` holds unpacked wheels of the package index, and clones of repositories:

    pip download --no-deps mani_skill==3.0.1 example-robot-data==6.0.0 dexmate-urdf==0.8.4 \
        hello-robot-stretch-urdf==0.1.2 hello-robot-stretch4-urdf==2026.10.20
    for wheel in *.whl; do unzip -q $wheel -d sources; done
    git -C sources clone https://github.com/OWNER/NAME   # at the commit below
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import kinfeas.robots
from kinfeas.importer.draft import draft_robot

SHIPPED = Path(kinfeas.robots.__file__).parent
HEAD = """# {title}
# Drafted by studies/zoo.py from {origin}, {licence}.
# The shapes in robot.urdf are primitives. The limits of the base are guesses.
"""


@dataclass(frozen=True)
class Source:
    """A vendor's description.

    Attributes:
        title: First line of the robot's YAML.
        file: Path within the sources.
        origin: Package or repository, its version, and the file.
        licence: Licence of the description.
        options: Arguments of `draft_robot`.
        arguments: Arguments of a xacro; `{}` is the folder of the file.
    """

    title: str
    file: str
    origin: str
    licence: str
    options: dict[str, Any] = field(default_factory=dict)
    arguments: dict[str, str] = field(default_factory=dict)


OMNIDIRECTIONAL = {"drive": "omnidirectional"}
DATA = "cmeel.prefix/share/example-robot-data/robots"
ROBOTS = {
    "fetch": Source(
        "Fetch (Fetch Robotics): differential drive, torso lift and arm of seven joints",
        "mani_skill/assets/robots/fetch/fetch.urdf",
        "mani_skill 3.0.1, after fetch_description",
        "BSD licence",
        {"drive": "differential"},
    ),
    "stretch3": Source(
        "Stretch SE3 (Hello Robot): differential drive, lift, telescope and wrist of three joints",
        "stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf",
        "hello-robot-stretch-urdf 0.1.2",
        "Clear BSD licence",
    ),
    "stretch4": Source(
        "Stretch 4 (Hello Robot): omnidirectional base, lift, telescope and wrist of three joints",
        "stretch4_urdf/SE4.xacro",
        "hello-robot-stretch4-urdf 2026.10.20",
        "Clear BSD licence",
        arguments={"batch": "francis", "tool": "eoa_wrist_dw4_tool_sg4", "pkg_path": "{}"},
    ),
    "tiago_pro": Source(
        "TIAGo Pro (PAL Robotics): omnidirectional base, torso lift and right arm of seven joints",
        f"{DATA}/tiago_pro_description/robots/tiago_pro.urdf",
        "example-robot-data 6.0.0",
        "Apache-2.0 licence",
        {"hand": "gripper_right_base_link", **OMNIDIRECTIONAL},
    ),
    "rby1_m": Source(
        "RB-Y1 M (Rainbow Robotics): omnidirectional base, torso of six joints, right arm of seven",
        "rby1-sdk/models/rby1m/urdf/model_v1.3.urdf",
        "RainbowRobotics/rby1-sdk at 38df326",
        "Apache-2.0 licence",
        {"hand": "ee_right", **OMNIDIRECTIONAL},
    ),
    "galaxea_r1": Source(
        "R1 (Galaxea): omnidirectional base, torso of four joints, right arm of six",
        "URDF/R1/urdf/r1_v2_1_0.urdf",
        "userguide-galaxea/URDF at a915b30",
        "BSD licence",
        {"hand": "right_gripper_link"},
    ),
    "ridgeback_ur5": Source(
        "Ridgeback (Clearpath) with UR5 (Universal Robots): omnidirectional, arm of six joints",
        "ocs2_robotic_assets/resources/mobile_manipulator/ridgeback_ur5/urdf/ridgeback_ur5.urdf",
        "leggedrobotics/ocs2_robotic_assets at b126d00",
        "BSD licence",
        OMNIDIRECTIONAL,
    ),
    "tidybot": Source(
        "TidyBot++ (Stanford) with Gen3 (Kinova): omnidirectional, arm of seven joints",
        "tidybot2/models/stanford_tidybot/tidybot.xml",
        "jimmyyhwu/tidybot2 at c8dd238",
        "MIT licence",
        OMNIDIRECTIONAL,
    ),
    "vega": Source(
        "Vega (Dexmate): omnidirectional base, torso of three joints, right arm of seven",
        "dexmate_urdf/robots/humanoid/vega_1/vega_1_gripper.urdf",
        "dexmate-urdf 0.8.4",
        "Apache-2.0 licence",
        {"hand": "R_gripper_base"},
    ),
    "lekiwi": Source(
        "LeKiwi (Hugging Face): omnidirectional base, SO-100 arm of five joints",
        "robot_descriptions/manipulator/LeRobot/lekiwi_description/urdf/lekiwi.urdf",
        "fiveages-sim/robot_descriptions at f609e7f",
        "Apache-2.0 licence",
    ),
}


GUESS = "# Guess: the manual has the limits of the base.\n"


def main() -> None:
    """Write the folders of the robots."""
    parser = argparse.ArgumentParser(description="Draft robots of vendors.")
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="all by default")
    parser.add_argument("--sources", type=Path, default=Path("sources"))
    parser.add_argument("--out", type=Path, default=SHIPPED)
    options = parser.parse_args()
    for name in options.robots or ROBOTS:
        source, folder = ROBOTS[name], options.out / name
        file = options.sources / source.file
        arguments = {key: value.format(file.parent) for key, value in source.arguments.items()}
        draft = draft_robot(file, name, arguments=arguments, **source.options)
        folder.mkdir(parents=True, exist_ok=True)
        text = HEAD.format(**vars(source)) + draft.yaml[draft.yaml.index("name: ") :]
        (folder / "robot.yaml").write_text(text.replace(GUESS, ""))
        (folder / "robot.urdf").write_text(draft.urdf)
        print(f"{name}: reach {draft.spec.reach.low:g} to {draft.spec.reach.high:g} m")


if __name__ == "__main__":
    main()
