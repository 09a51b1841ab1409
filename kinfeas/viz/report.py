"""The report of `kinfeas demo`, one self-contained HTML page: a trained policy beside baselines."""

import base64
import os
import platform
from collections.abc import Mapping, Sequence
from html import escape
from importlib.metadata import version

from kinfeas.evaluation.evaluate import Summary
from kinfeas.evaluation.paper import LEARNED, paper_figures

HEADS = (
    "", "without a failure", "95 % interval", "within 5 cm", "failures", "EE deviation",
    "arm jumps",
)  # fmt: skip
"""Heads of the columns of `rows_of`."""

_VERSIONS = ("kinfeas", "numpy", "numba", "torch", "stable-baselines3")
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#2b2f36;max-width:1100px;margin:2.5rem auto;
padding:0 1.5rem}
.note,figcaption,dt,th{color:#6b727d;font-size:.9rem}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
tr{border-bottom:1px solid #e3e6ea}th,td{text-align:right;padding:.4rem .6rem}
th:first-child,td:first-child{text-align:left}tr:nth-child(2){background:#eef6f2}
figure{margin:2rem 0}img{max-width:100%}pre{background:#f5f6f8;padding:1rem;overflow-x:auto}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1.2rem;font-size:.9rem}
dd{margin:0}
"""


def rows_of(results: Sequence[Summary]) -> list[list[str]]:
    """Return the table of a trained policy with its ceiling, baselines, and the paper's figures."""
    rows = [
        [
            result["policy"],
            f"{result['success']:.1%}",
            f"{result['success_low']:.1%} - {result['success_high']:.1%}",
            f"{result['within_5cm']:.1%}",
            f"{result['ik_failures_per_episode']:.2f}",
            f"{1000.0 * result['mean_deviation_m']:.1f} mm",
            f"{result['joint_jumps_per_episode']:.2f}",
        ]
        for result in results
    ]
    trained = results[0]
    rows[0][0] = "trained policy"
    low, high = trained["ceiling_low"], trained["ceiling_high"]
    rows.append(["ceiling", f"{trained['ceiling']:.1%}", f"{low:.1%} - {high:.1%}"])
    paper = paper_figures(trained["robot"], trained["task"])
    for key, name in ((LEARNED, "learned policy"), ("follow_ee", "follow_ee")):
        if key in paper:
            rows.append([f"paper: {name}", f"{paper[key].success:.1%}"])
    return rows


def page(results: Sequence[Summary], pictures: Mapping[str, bytes], commands: Sequence[str]) -> str:
    """Return the page of a trained policy with its ceiling, and baselines.

    `pictures` are PNG files by caption, `commands` reproduce the page.
    """
    trained, *baselines = results
    episodes, seed = trained["episodes"], trained["seed"]
    title = f"A base policy for {trained['robot']} on {trained['task']}"
    summary = (
        f"The policy completes {trained['success']:.1%} of {episodes} fresh episodes without an IK "
        f"failure, the better baseline {max(result['success'] for result in baselines):.1%}. At "
        f"most {trained['ceiling']:.1%} of the goals are reachable."
    )
    notes = (
        f"Episodes 0 to {episodes - 1} of seed {seed} in all rows except the paper's, which come "
        "from its own program. Intervals are Wilson's.",
        "All policies act without command filters. Ceiling: goals that the end-effector reaches "
        "from some base pose.",
    )
    figures = "".join(
        f"<figure><img src='data:image/png;base64,{base64.b64encode(content).decode()}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
        for caption, content in pictures.items()
    )
    lines = [
        "".join(f"<td>{escape(cell)}</td>" for cell in [*row, *[""] * (len(HEADS) - len(row))])
        for row in rows_of(results)
    ]
    facts = {"machine": f"{platform.platform()}, {os.cpu_count()} cores"}
    facts |= {"Python": platform.python_version(), **{name: version(name) for name in _VERSIONS}}
    return (
        "<!doctype html>\n<html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{_STYLE}</style>\n"
        f"<h1>{escape(title)}</h1><p>{escape(summary)}</p>\n"
        f"<table><tr>{''.join(f'<th>{head}</th>' for head in HEADS)}</tr>\n"
        f"{''.join(f'<tr>{line}</tr>{chr(10)}' for line in lines)}</table>\n"
        f"{''.join(f'<p class=note>{note}</p>' for note in notes)}\n{figures}\n"
        f"<h2>Commands</h2><pre>{escape(chr(10).join(commands))}</pre>\n<h2>Versions</h2><dl>"
        f"{''.join(f'<dt>{key}</dt><dd>{escape(value)}</dd>' for key, value in facts.items())}"
        "</dl>\n</html>\n"
    )
