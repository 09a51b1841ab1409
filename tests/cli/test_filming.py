import pytest

from tests.cli.conftest import is_one_line

EVALUATE = ("evaluate", "--policy", "follow_ee", "--robot", "hsr", "--episodes", "1")


@pytest.mark.parametrize("world", ["analytic", "pybullet"])
def test_an_episode_is_shown_as_picture_and_page(kinfeas, tmp_path, world):
    pytest.importorskip("viser")
    if world == "pybullet":
        pytest.importorskip("pybullet")
    outcome = kinfeas(
        *EVALUATE, "--world", world, "--set", "world.max_seconds=0.5",
        "--video", "four.png", "--replay", "page.html", "--picture", "episode.png",
        "--episodes", "2", "--episode", "1",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert outcome.out.splitlines()[-3:] == ["four.png", "page.html", "episode.png"]
    for name in ("four.png", "episode.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "page.html").stat().st_size < 3_000_000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--gui",), "--gui needs --world pybullet"),
        (("--episode", "0"), "--episode needs --video, --replay or --picture"),
        (("--world", "pybullet", "--video", "film.avi"), "must end in one of: .gif, .mp4, .png"),
        (("--world", "pybullet", "--video", "none/film.gif"), "cannot be written"),
        (("--world", "pybullet", "--replay", "page.gif"), "must end in .html"),
        (
            ("--world", "pybullet", "--video", "a.png", "--episode", "1"),
            "--episode must be below --episodes, 1, not 1",
        ),
        (
            ("--world", "pybullet", "--video", "a.png", "--episode", "100000000000000000000"),
            "--episode must be below --episodes, 1, not 100000000000000000000",
        ),
        (
            ("--world", "pybullet", "--video", "a.png", "--json", "a.png"),
            "--json and --video must differ",
        ),
        (
            ("--world", "pybullet", "--replay", "a.html", "--json", "a.html"),
            "--json and --replay must differ",
        ),
    ],
)
def test_bad_input_is_one_line(kinfeas, arguments, words):
    outcome = kinfeas(*EVALUATE, *arguments)
    assert is_one_line(outcome), outcome.err
    assert words in outcome.err
