"""A report: one page of HTML with everything in it, to be kept, mailed and opened anywhere."""

import base64
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

from kinfeas.core.metrics import Share
from kinfeas.evaluation.paper import paper_figures
from kinfeas.io.files import write_file

_VERSIONS = ("kinfeas", "numpy", "numba", "torch", "stable-baselines3")


@dataclass(frozen=True)
class Row:
    """A line of the report's table.

    Attributes:
        name: Who or what did it.
        success: Share of episodes without a failure.
        figures: What else is known, as `metrics.summarize` names it; empty cells for the rest.
        ours: Whether to set it off as what the report is about.
    """

    name: str
    success: Share
    figures: Mapping[str, Any]
    ours: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture with what it shows."""

    caption: str
    png: bytes


@dataclass(frozen=True)
class Report:
    """What a report tells.

    Attributes:
        title: Its heading.
        summary: One sentence below it.
        rows: The table.
        notes: Sentences below the table.
        pictures: In order.
        commands: Lines that make all of it again.
    """

    title: str
    summary: str
    rows: Sequence[Row]
    notes: Sequence[str]
    pictures: Sequence[Picture]
    commands: Sequence[str]


def write_report(report: Report, path: Path) -> None:
    """Write a report as a single HTML file that needs nothing else.

    Raises:
        KinfeasError: If the file cannot be written.
    """
    write_file(path, to_html(report).encode())


def to_html(report: Report) -> str:
    """Return a report as a page of HTML."""
    notes = "".join(f"<p class=note>{escape(note)}</p>" for note in report.notes)
    commands = escape("\n".join(report.commands))
    facts = "".join(
        f"<dt>{escape(key)}</dt><dd>{escape(value)}</dd>" for key, value in machine().items()
    )
    return (
        "<!doctype html>\n<html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(report.title)}</title><style>{_STYLE}</style>\n"
        f"<h1>{escape(report.title)}</h1><p class=summary>{escape(report.summary)}</p>\n"
        f"{_table(report.rows)}{notes}\n"
        f"{''.join(_figure(picture) for picture in report.pictures)}\n"
        f"<h2>How to make it again</h2><pre>{commands}</pre>\n"
        f"<h2>Made with</h2><dl>{facts}</dl>\n</html>\n"
    )


def machine() -> dict[str, str]:
    """Return what the figures were measured on and with."""
    return {
        "processor": f"{_processor()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.release()}",
        "Python": platform.python_version(),
        **{name: version(name) for name in _VERSIONS},
    }


def paper_success(robot: str, task: str) -> dict[str, float]:
    """Return the paper's shares, 0-1, for a robot and a task, by policy; `policy` is its own."""
    return {name: figures.success for name, figures in paper_figures(robot, task).items()}


def _table(rows: Sequence[Row]) -> str:
    heads = ["", "without a failure", "95 % interval", ""]
    heads += ["within 5 cm", "failures", "EE deviation", "arm jumps"]
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    return f"<table><tr>{head}</tr>\n{''.join(_line(row) for row in rows)}</table>\n"


def _line(row: Row) -> str:
    share, figures = row.success, row.figures
    exact = share.low == share.high
    cells = [
        escape(row.name),
        f"<b>{share.value:.1%}</b>",
        "" if exact else f"{share.low:.1%} &ndash; {share.high:.1%}",
        _bar(share),
        _cell(figures, "within_5cm", "{:.1%}"),
        _cell(figures, "ik_failures_per_episode", "{:.2f}"),
        _cell(figures, "mean_deviation_m", "{:.1f} mm", 1000.0),
        _cell(figures, "joint_jumps_per_episode", "{:.2f}"),
    ]
    kind = " class=ours" if row.ours else ""
    return f"<tr{kind}>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>\n"


def _cell(figures: Mapping[str, Any], key: str, form: str, factor: float = 1.0) -> str:
    value = figures.get(key)
    return "" if value is None else form.format(factor * float(value))


def _bar(share: Share) -> str:
    """Return a bar from 0 to 1 with its interval."""
    value, low, high = (160.0 * part for part in (share.value, share.low, share.high))
    whisker = f"<path d='M{low:.1f} 7H{high:.1f}M{low:.1f} 3V11M{high:.1f} 3V11'/>"
    return (
        "<svg width=164 height=14 viewBox='-2 0 164 14'>"
        "<rect class=all y=2 width=160 height=10 rx=2 />"
        f"<rect y=2 width={value:.1f} height=10 rx=2 />{whisker if high > low else ''}</svg>"
    )


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode()
    caption = escape(picture.caption)
    return (
        f"<figure><img src='data:image/png;base64,{data}' alt='{caption}'>"
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def _processor() -> str:
    """Return the processor's name as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#2b2f36;max-width:1100px;
margin:2.5rem auto;padding:0 1rem}
h1{font-size:1.7rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
.summary{font-size:1.1rem;margin:0 0 1.4rem}.note{color:#6b727d;font-size:.9rem;margin:.3rem 0}
table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}
th{font-weight:600;font-size:.85rem;color:#6b727d;white-space:nowrap}
th,td{text-align:right;padding:.4rem .6rem;border-bottom:1px solid #e3e6ea}
th:first-child,td:first-child{text-align:left;padding-left:.4rem}tr.ours{background:#eef6f2}
svg{display:block}svg rect{fill:#8fb4dc}svg rect.all{fill:#eef0f3}tr.ours rect{fill:#17906b}
tr.ours rect.all{fill:#dfeae5}svg path{stroke:#2b2f36;stroke-width:1.3;fill:none}
figure{margin:2rem 0}img{max-width:100%;height:auto}figcaption{color:#6b727d;font-size:.9rem}
pre{background:#f5f6f8;padding:1rem;border-radius:6px;overflow-x:auto}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.15rem 1.2rem;font-size:.9rem}
dt{color:#6b727d}dd{margin:0}
"""
