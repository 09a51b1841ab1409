import shutil
from types import SimpleNamespace

import pytest

from kinfeas.core.errors import KinfeasError
from kinfeas.policies.network import read_network
from kinfeas.policies.onnx_policy import read_policy_file
from tests.sim2real.policy_cases import write_run

hub = pytest.importorskip("kinfeas.sim2real.hub")


@pytest.fixture
def remote(tmp_path, monkeypatch):
    """A folder that takes the place of the Hub; repositories are folders in it."""
    place = tmp_path / "hub"

    class Api:
        def create_repo(self, repo, *, private, exist_ok):
            hub_name(repo)
            (place / repo).mkdir(parents=True, exist_ok=exist_ok)

        def upload_folder(self, *, repo_id, folder_path, commit_message):
            shutil.copytree(folder_path, place / repo_id, dirs_exist_ok=True)
            return SimpleNamespace(commit_url=f"hub:{repo_id}")

    def snapshot_download(repo, *, revision, local_dir, allow_patterns):
        hub_name(repo)
        for path in (place / repo).iterdir():
            if path.name in allow_patterns:
                shutil.copy(path, local_dir)

    monkeypatch.setattr(hub, "HfApi", Api)
    monkeypatch.setattr(hub, "snapshot_download", snapshot_download)
    return place


def hub_name(repo):
    from huggingface_hub.utils import validate_repo_id

    validate_repo_id(repo)


def test_a_policy_comes_back_from_the_hub(remote, pr2, tmp_path):
    network = write_run(pr2, tmp_path / "run" / "checkpoints" / "best")
    assert hub.push(tmp_path / "run", pr2, "me/pr2-base") == "hub:me/pr2-base"
    assert {path.name for path in (remote / "me/pr2-base").iterdir()} == set(hub.FILES)
    (remote / "me/pr2-base" / "evil.py").touch()
    trained = hub.pull("me/pr2-base", tmp_path / "mine")
    assert trained.robot == "pr2"
    assert read_network(tmp_path / "mine", pr2).equals(network)
    assert read_policy_file(tmp_path / "mine" / "policy.onnx", pr2)
    assert {path.name for path in (tmp_path / "mine").iterdir()} == set(hub.FILES)
    card = (tmp_path / "mine" / "README.md").read_text()
    assert "kinfeas pull me/pr2-base" in card


def test_what_is_no_policy_is_not_kept(remote, pr2, tmp_path):
    (remote / "me/other").mkdir(parents=True)
    (remote / "me/other" / "README.md").write_text("# Other")
    with pytest.raises(KinfeasError):
        hub.pull("me/other", tmp_path / "mine")
    assert not (tmp_path / "mine").exists()
    write_run(pr2, tmp_path / "run")
    with pytest.raises(KinfeasError, match="a b"):
        hub.push(tmp_path / "run", pr2, "me/a b")
