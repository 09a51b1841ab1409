"""Examples that the help of each command ends with; a test holds them against the options."""

EXAMPLES = {
    "demo": ("kinfeas demo", "kinfeas demo --robot hsr --minutes 3 --out runs/hsr_demo"),
    "train": (
        "kinfeas train --robot pr2 --minutes 3 --out runs/pr2",
        "kinfeas train --resume runs/pr2",
        "kinfeas train --robot hsr --adapters harsh --set learner.net_arch=[128,128]",
    ),
    "evaluate": (
        "kinfeas evaluate --policy runs/pr2",
        "kinfeas evaluate --policy pretrained --robot tiago --task door --episodes 100",
        "kinfeas evaluate --policy pretrained --robot hsr --task door --world pybullet "
        "--episodes 5",
        "kinfeas evaluate --policy pretrained --set 'task.motion={generator: minimum_jerk}'",
    ),
    "benchmark": (
        "kinfeas benchmark --quick --out runs/quick",
        "kinfeas benchmark --out runs/mine --processes 2",
        "kinfeas benchmark --world pybullet --policy pretrained --episodes 20",
    ),
    "ceiling": (
        "kinfeas ceiling --robot tiago",
        "kinfeas ceiling --robot pr2 --task door --path --episodes 100",
    ),
    "deploy": (
        "kinfeas deploy pretrained --goal 1.5 0.3 0.8",
        "kinfeas deploy pr2.onnx --task door --adapters pr2_like",
        "kinfeas deploy pr2.onnx --backend ros2 --goal 0.8 -0.2 0.9 --seconds 10 "
        "--set time_scale=0.25 --set guards.max_linear_velocity=0.05 "
        "--set guards.max_angular_velocity=0.2",
    ),
    "fit": ("kinfeas fit --demonstrations demonstrations/door/open --out my_door.yaml",),
    "export": (
        "kinfeas export runs/pr2 --out pr2.onnx",
        "kinfeas export --check pr2.onnx --robot pr2",
    ),
    "robot import": (
        "kinfeas robot import fetch.urdf --out robots --picture fetch.png",
        "kinfeas robot import tiago_dual.urdf --ee arm_left_tool_link --name left --out robots",
    ),
    "simulate": ("kinfeas simulate --backend ros2 --robot pr2 --task door",),
    "speed": ("kinfeas speed --robot hsr",),
    "view": (
        "kinfeas view --scene room --picture room.png",
        "kinfeas view --record runs/deploy/FILE.csv --picture run.png --html run.html",
    ),
    "plugins list": ("kinfeas plugins list",),
    "plugins info": ("kinfeas plugins info linear", "kinfeas plugins info pr2"),
    "plugins check": (
        "kinfeas plugins check minimum_jerk --set min_duration=2 --picture motions.png",
    ),
    "plugins new": (
        "kinfeas plugins new arc --out arc",
        "kinfeas plugins new porter --kind robot --out porter",
    ),
}


def epilog(command: str) -> str:
    """Return what the help of a command ends with."""
    return "\n\n".join(("[bold]Examples[/]", *EXAMPLES[command]))
