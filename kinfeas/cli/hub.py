"""`kinfeas push` and `kinfeas pull`: policies in repositories of the Hugging Face Hub."""

from pathlib import Path
from typing import Annotated

import typer

from kinfeas.cli import options
from kinfeas.cli.output import status
from kinfeas.core.errors import KinfeasError

RepoName = Annotated[str, typer.Argument(help="Repository: USER/NAME.")]


def push(
    policy: Annotated[str, typer.Argument(help="Folder of a run or checkpoint, or pretrained.")],
    repo: RepoName,
    robot: options.PolicyRobotName = None,
    private: Annotated[bool, typer.Option("--private", help="Create a private one.")] = False,
) -> None:
    """Upload a policy to the Hugging Face Hub, with its ONNX file and model card.

    Log in first: hf auth login, or the environment variable HF_TOKEN.

    Example: kinfeas push runs/pr2 USER/pr2-base
    """
    from kinfeas.policies import pretrained

    known = options.read_robot(robot or options.robot_of(policy))
    folder = pretrained.folder(known.name, policy)
    from kinfeas.sim2real import hub

    with status("uploading"):
        address = hub.push(folder, known, repo, private=private)
    typer.echo(address)


def pull(
    repo: RepoName,
    out: Annotated[Path, typer.Option(help="New folder for the policy.")],
    revision: Annotated[str | None, typer.Option(help="Branch, tag or commit.")] = None,
) -> None:
    """Download a policy from the Hugging Face Hub. Its files run no code.

    Example: kinfeas pull USER/pr2-base --out policies/pr2
    """
    if out.exists():
        raise KinfeasError(f"{out}: already there; use another --out")
    from kinfeas.sim2real import hub

    with status("downloading"):
        trained = hub.pull(repo, out, revision)
    typer.echo(f"{out}: a policy for {trained.robot}")
    typer.echo(f"evaluate it: kinfeas evaluate --policy {out} --robot {trained.trained_with}")
