"""Run an exported policy (pr2.onnx) with numpy and onnxruntime alone."""

import json

import numpy as np
import onnxruntime


def times(a, b):
    """Return the rotation `b` followed by `a`, unit quaternions x y z w with w >= 0."""
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    quaternion = np.append(vector, a[3] * b[3] - a[:3] @ b[:3])
    return quaternion if quaternion[3] >= 0.0 else -quaternion


def in_frame(frame, pose):
    """Return a world pose x y z qx qy qz qw in the coordinates of the pose `frame`."""
    q, offset = frame[3:] * [-1, -1, -1, 1], pose[:3] - frame[:3]
    position = offset + 2.0 * np.cross(q[:3], np.cross(q[:3], offset) + q[3] * offset)
    return np.concatenate([position, times(q, pose[3:])])


def observe(terms, base, ee_in_base, planned, goal, joints):
    """Return the metadata's `terms` in order; `base`, `planned` and `goal` are world poses."""
    planned, goal = in_frame(base, planned), in_frame(base, goal)
    path = goal[:3] - planned[:3]  # of a straight motion
    length = max(np.linalg.norm(path), 1e-9)
    values = {
        "ee_position": ee_in_base[:3],
        "ee_orientation": ee_in_base[3:],
        "planned_velocity": (planned[:3] - ee_in_base[:3]) / 0.1,
        "planned_rotation": times(planned[3:], ee_in_base[3:] * [-1, -1, -1, 1]),
        "goal_position": goal[:3],
        "goal_orientation": goal[3:],
        "joint_positions": joints,
        "planned_ahead": [planned[:3] + path * min(d / length, 1.0) for d in (0.5, 1.0, 1.5)],
    }
    for term in terms:  # 0 without obstacles: nothing in range of the scans, no planned base
        if term["name"] in ("planned_base", "scan_low", "scan_high"):
            values[term["name"]] = np.zeros(term["size"])
        elif term["name"] not in values:
            raise SystemExit(f"this example does not compute the term {term['name']}")
    return np.concatenate([np.ravel(values[term["name"]]) for term in terms])


def main():
    """Check the golden pairs, then print and return the base twist for one observation."""
    session = onnxruntime.InferenceSession("pr2.onnx", providers=["CPUExecutionProvider"])
    metadata = session.get_modelmeta().custom_metadata_map
    about = {key.removeprefix("kinfeas."): json.loads(text) for key, text in metadata.items()}

    # Golden pairs: observations, and the training policy's actions.
    golden = {name: np.array(rows, np.float32) for name, rows in about["golden"].items()}
    (actions,) = session.run(["action"], {"observation": golden["observation"]})
    assert np.abs(actions - golden["action"]).max() <= 1e-5

    # Replace with your robot's base pose, EE pose, planned EE pose 0.1 s ahead, goal and joints.
    base = np.array([1.0, 0.5, 0.0, 0.0, 0.0, 0.0, 1.0])
    ee_in_base = np.array([0.45, 0.0, 0.543, 0.0, 0.0, 0.0, 1.0])
    planned = np.array([1.459, 0.503, 0.546, 0.0, 0.0, 0.0, 1.0])
    goal = np.array([2.5, 0.8, 0.8, 0.0, 0.0, 0.0, 1.0])
    joints = np.array([0.359647, 1.22538, 0.0, -1.59997, 2.34256, -0.513323, -2.41144])
    observation = observe(about["observation"], base, ee_in_base, planned, goal, joints)
    observation = observation[np.newaxis].astype(np.float32)
    (actions,) = session.run(["action"], {"observation": observation})

    # From [-1, 1] to m/s and rad/s in the base frame; the planar velocity is clipped by its norm.
    (term,) = about["action"]
    limits = np.array(term["scale"])
    twist = actions[0] * limits
    planar = twist[:-1]
    twist[:-1] *= limits[0] / max(np.linalg.norm(planar), limits[0])
    for name, value in zip(term["entries"], twist, strict=True):
        print(f"{name}: {value:.3f}")
    print(term["unit"])
    return observation, twist


if __name__ == "__main__":
    main()
