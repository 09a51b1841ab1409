from pathlib import Path

import pytest

ARM = """<robot name="dolly">
  <link name="base">
    <collision><origin xyz="0 0 0.2"/><geometry><box size="0.5 0.4 0.4"/></geometry></collision>
  </link>
  <link name="head"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
  <link name="lower"/><link name="upper"/><link name="wrist"/><link name="tool"/>
  <link name="palm"><collision><geometry><box size="0.04 0.1 0.04"/></geometry></collision></link>
  <link name="left">
    <collision><origin xyz="0.05 0 0"/><geometry><box size="0.1 0.02 0.02"/></geometry></collision>
  </link>
  <link name="right">
    <collision><origin xyz="0.05 0 0"/><geometry><box size="0.1 0.02 0.02"/></geometry></collision>
  </link>
  <joint name="neck" type="revolute"><parent link="base"/><child link="head"/>
    <origin xyz="-0.2 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1"/></joint>
  <joint name="pan" type="continuous"><parent link="base"/><child link="lower"/>
    <origin xyz="0.1 0 0.5"/><axis xyz="0 0 1"/></joint>
  <joint name="lift" type="revolute"><parent link="lower"/><child link="upper"/>
    <origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="1.5"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="wrist"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1e16" upper="1e16" velocity="2"/></joint>
  <joint name="mount" type="fixed"><parent link="wrist"/><child link="palm"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 0 0"/></joint>
  <joint name="frame" type="fixed"><parent link="palm"/><child link="tool"/></joint>
  <joint name="l" type="prismatic"><parent link="palm"/><child link="left"/>
    <origin xyz="0.02 0.01 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" velocity="0.1" effort="30"/></joint>
  <joint name="r" type="prismatic"><parent link="palm"/><child link="right"/>
    <origin xyz="0.02 -0.01 0"/><axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.04" velocity="0.1" effort="20"/></joint>
</robot>
"""
"""A box with an arm of three joints, a head and a gripper."""


STUCK = (
    ('name="mount" type="fixed"', 'name="mount" type="revolute"'),
    ('<axis xyz="0 0 0"/>', '<axis xyz="0 0 1"/><limit lower="0.1234567" upper="0.1234567"/>'),
)
"""Changes to it that make of a fixed joint one whose limits leave it no room."""


@pytest.fixture
def few(monkeypatch):
    """Measure reach with few goals; the full number takes seconds."""
    monkeypatch.setattr("kinfeas.importer.reach._GOALS", 8)
    monkeypatch.setattr("kinfeas.importer.reach._STAGES", (4, 16))


@pytest.fixture
def dolly(tmp_path) -> Path:
    path = tmp_path / "dolly.urdf"
    path.write_text(ARM)
    return path


@pytest.fixture
def changed(tmp_path):
    def write(*changes: tuple[str, str]) -> Path:
        text = ARM
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path = tmp_path / "changed.urdf"
        path.write_text(text)
        return path

    return write
