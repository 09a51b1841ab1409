import numpy as np
import pytest

from kinfeas.control.targets import RULES, TargetInbox, TargetRules
from kinfeas.core import spatial
from tests.builders import assert_near

DT = 0.02
RULE = TargetRules(timeout=0.1, max_velocity=0.2, max_angular_velocity=0.5, max_jump=0.5)
ROW = np.zeros(1, dtype=np.intp)


def inbox(rules=RULE, n=1, size=4):
    made = TargetInbox(rules, size)
    made.start(np.tile(spatial.IDENTITY, (n, 1)))
    return made


def at(x=0.0, y=0.0, z=0.0):
    return spatial.IDENTITY + np.array([x, y, z, 0.0, 0.0, 0.0, 0.0])


def send(box, now, pose, sent=None):
    times = np.array([now if sent is None else sent])
    box.put_poses(ROW, np.array([now]), times, times[:, np.newaxis], pose[np.newaxis, np.newaxis])


def send_twist(box, now, *twist):
    box.put_twists(ROW, np.array([now]), np.array([now]), np.array([twist]))


def advance(box, now):
    """Move the target for one period; return it."""
    box.advance(ROW, np.full(1, now), DT, DT)
    return box.target[0]


def counted(box):
    return {name: n for name, n in zip(RULES, box.counts.sum(axis=0).tolist(), strict=True) if n}


def test_a_slow_stream_of_poses_moves_the_target_steadily():
    box, x = inbox(), []
    for k in range(60):
        if k % 4 == 0:
            send(box, k * DT, at(0.1 * k * DT))
        x.append(advance(box, k * DT)[0])
    np.testing.assert_allclose(np.diff(x)[8:], 0.1 * DT, rtol=1e-6)


def test_poses_of_a_chunk_are_reached_at_their_times():
    box = inbox()
    times, poses = np.array([[0.2, 0.4, 0.6]]), np.array([[at(), at(0.02), at(0.02, 0.03)]])
    box.put_poses(ROW, np.zeros(1), np.zeros(1), times, poses)
    path = np.array([advance(box, k * DT)[:2] for k in range(30)])
    np.testing.assert_allclose(path[[19, 29]], [[0.02, 0.0], [0.02, 0.03]], atol=1e-9)


@pytest.mark.parametrize(("rule", "sent", "pose"), [
    ("invalid", 1.0, at(np.nan)), ("invalid", np.nan, at()), ("invalid", 1.0, at(1e300)),
    ("invalid", 1.0, np.zeros(7)), ("late", 0.85, at()), ("repeated", 0.98, at()),
    ("jump", 1.0, at(0.6)), ("jump", 1.0, spatial.planar_pose(0.0, 0.0, 3.0)),
])  # fmt: skip
def test_a_rule_ignores_a_message(rule, sent, pose):
    box = inbox()
    send(box, 0.99, at(0.01))
    send(box, 1.0, pose, sent)
    assert counted(box) == {"accepted": 1, rule: 1}
    assert advance(box, 1.0)[0] <= RULE.max_velocity * DT + 1e-12


def test_targets_wait_where_the_motion_waits():
    """A target that the EE did not go to is withdrawn, so that none lies in wait."""
    box = inbox()
    send_twist(box, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    advance(box, 0.0)
    for _ in range(3):
        reached = box.target.copy()
        advance(box, 0.0)
        box.wait(ROW, np.zeros(1), reached)
        np.testing.assert_allclose(box.target, reached)
    advance(box, 0.0)
    box.wait(ROW, np.full(1, 0.5), reached)
    assert box.target[0, 0] == pytest.approx(1.5 * 0.1 * DT)


def test_a_sender_is_followed_after_a_long_wait():
    box = inbox()
    for k in range(200):
        send(box, k * DT, at(0.2 * k * DT))
        reached = box.target.copy()
        advance(box, k * DT)
        if k <= 180:
            box.wait(ROW, np.zeros(1), reached)
    assert counted(box) == {"accepted": 200}
    send(box, 4.0, at(2.0))
    assert counted(box) == {"accepted": 200, "jump": 1}
    ahead = box.target[0, 0]
    assert advance(box, 4.0)[0] == pytest.approx(ahead + 0.2 * DT)
    send(box, 5.0, at(0.8))  # near the last message, but that is too old
    assert counted(box) == {"accepted": 200, "jump": 2}


def test_targets_do_not_leave_the_heights_but_may_come_back():
    box = inbox(TargetRules(heights=(0.4, 1.0)))
    for twist, z in ((-0.1, 0.0), (0.1, 0.1 * DT)):
        send_twist(box, 1.0 + twist, 0.0, 0.0, twist, 0.0, 0.0, 0.0)
        assert advance(box, 1.0 + twist)[2] == pytest.approx(z)


def hostile(rng, n, shape):
    """Return numbers of which many are not finite, far too large or far too small."""
    values = rng.normal(size=(n, *shape))
    values *= 10.0 ** rng.uniform(-12, 12, (n, *[1] * len(shape))) ** rng.integers(0, 2)
    odd = rng.choice([np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324], size=values.shape)
    return np.where(rng.random(values.shape) < 0.02, odd, values)


def test_a_hundred_thousand_hostile_messages_neither_speed_up_nor_keep_a_target_alive():
    n, rounds, k = 1000, 100, 3
    rng, box = np.random.default_rng(0), inbox(n=n)
    rows, live_until = np.arange(n), np.full(n, -np.inf)
    for step in range(rounds):
        now = np.full(n, step * DT)
        sent = np.where(rng.random(n) < 0.7, now, now - np.abs(hostile(rng, n, ())))
        accepted = box.counts[:, 0].copy()
        if rng.random() < 0.5:
            box.put_twists(rows, now, sent, hostile(rng, n, (6,)))
            last = sent
        else:
            poses = hostile(rng, n, (k, 7))
            usual = rng.random(n) < 0.7
            poses[usual] = box.target[usual, np.newaxis] + 0.0
            poses[..., :3] += rng.normal(size=(n, k, 3)) * 0.2
            times = now[:, np.newaxis] + np.cumsum(rng.uniform(-0.01, 0.2, (n, k)), axis=1)
            box.put_poses(rows, now, sent, times, poses)
            last = times[:, -1]
        accepted = box.counts[:, 0] > accepted
        live_until[accepted] = last[accepted] + RULE.timeout
        before = box.target.copy()
        box.advance(rows, now, DT, DT)
        target = box.target
        assert np.isfinite(target).all()
        np.testing.assert_allclose(np.linalg.norm(target[:, 3:], axis=1), 1.0, atol=1e-9)
        metres, radians = RULE.max_velocity * DT, RULE.max_angular_velocity * DT
        assert_near(before, target, metres * (1.0 + 1e-9), radians * (1.0 + 1e-6))
        stale = now > live_until
        assert not box.live[stale].any()
        assert (spatial.distance(before, target)[0][stale] == 0.0).all()
        box.wait(rows, rng.uniform(0.0, 1.0, n), before)
        assert np.isfinite(box.target).all()
    assert box.counts.sum() == n * rounds
    assert (box.counts.sum(axis=0) > 0).all()
