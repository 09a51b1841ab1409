"""Policies to and from repositories of the Hugging Face Hub."""

from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

from huggingface_hub import HfApi, snapshot_download
from huggingface_hub.errors import HFValidationError

from kinfeas.core.errors import KinfeasError
from kinfeas.io.files import write_folder
from kinfeas.io.policy_metadata import Trained, policy_folder, read_trained
from kinfeas.policies.network import WEIGHTS, read_network
from kinfeas.robots.robot import Robot
from kinfeas.sim2real.card import model_card
from kinfeas.sim2real.export import export

FILES = ("policy.json", WEIGHTS, "policy.onnx", "README.md")
"""Files of a policy in a repository."""


def push(folder: Path, robot: Robot, repo: str, *, private: bool = False) -> str:
    """Upload the policy of a run or of a checkpoint; return the address of the commit.

    The repository is created if needed. It gets the policy, its ONNX file and its model card.

    Raises:
        KinfeasError: If there is no policy for this robot, or `repo` is no name USER/NAME.
        OSError: If the Hub cannot be reached or denies access.
    """
    read_network(folder, robot)
    with TemporaryDirectory() as place:
        content = Path(place)
        for name in FILES[:2]:
            (content / name).write_bytes((policy_folder(folder) / name).read_bytes())
        policy, _ = export(folder, robot, content / "policy.onnx")
        card = model_card(policy.metadata).replace("USER/NAME", repo)
        (content / "README.md").write_text(card, encoding="utf-8")
        api = HfApi()
        try:
            api.create_repo(repo, private=private, exist_ok=True)
        except HFValidationError as error:
            raise KinfeasError(str(error)) from error
        message = f"Policy for {robot.name}"
        commit = api.upload_folder(repo_id=repo, folder_path=content, commit_message=message)
    return str(commit.commit_url)


def pull(repo: str, out: Path, revision: str | None = None) -> Trained:
    """Download the policy of a repository into a folder; return its metadata.

    A revision is a branch, a tag or a commit. Only the files of a policy are taken.

    Raises:
        KinfeasError: If the repository has no policy, or `repo` is no name USER/NAME.
        OSError: If the Hub cannot be reached or denies access.
    """
    with TemporaryDirectory() as place:
        try:
            snapshot_download(repo, revision=revision, local_dir=place, allow_patterns=list(FILES))
        except HFValidationError as error:
            raise KinfeasError(str(error)) from error
        trained = read_trained(Path(place))
        if not (Path(place) / WEIGHTS).is_file():
            raise KinfeasError(f"{repo}: no policy: there is no {WEIGHTS}")

        def fill(fresh: Path) -> None:
            for path in Path(place).iterdir():
                if path.name in FILES:
                    copyfile(path, fresh / path.name)

        write_folder(out, fill)
    return trained
