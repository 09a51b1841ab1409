from kinfeas.backends.pybullet.complaints import complaint, remarks, unread_mesh

REFUSED = """b3Warning[examples/BulletUrdfImporter.cpp,126]:
No inertial data for link, using mass=1b3Warning[examples/BulletUrdfImporter.cpp,126]:
base_linkb3Warning[examples/UrdfFindMeshFile.h,54]:
/tmp/a b/body.urdf:8: invalid mesh filename extension '.ply'
b3Error[examples/BulletUrdfImporter.cpp,121]:
Could not parse visual element for Link:b3Error[examples/BulletUrdfImporter.cpp,121]:
base_link"""
PLAIN = """b3Warning[examples/BulletUrdfImporter.cpp,126]:
No inertial data for link, using mass=1b3Error[examples/BulletUrdfImporter.cpp,121]:
URDF file with multiple root links found:
"""
UNREAD = """b3Warning[examples/BulletUrdfImporter.cpp,846]:
/tmp/: cannot extract mesh from '/a b/c.stl'
"""
SEEN = """b3Warning[examples/BulletUrdfImporter.cpp,1166]:
/tmp/: cannot extract anything useful from mesh '/a b/c.stl'
"""
LOST = """b3Warning[examples/TinyRendererVisualShapeConverter.cpp,558]:
issue extracting mesh from COLLADA/STL file /a b/c.stl
"""


def test_the_first_error_counts_or_what_led_to_it():
    assert complaint(REFUSED) == "invalid mesh filename extension '.ply'"
    assert complaint(PLAIN) == "URDF file with multiple root links found:"
    assert complaint("") == complaint(UNREAD) == ""


def test_meshes_in_which_nothing_was_found():
    assert [unread_mesh(said) for said in (UNREAD, SEEN, LOST)] == ["/a b/c.stl"] * 3
    assert unread_mesh(REFUSED) is None


def test_what_has_no_consequence_is_not_passed_on():
    harmless = """b3Warning[examples/BulletUrdfImporter.cpp,126]:
No inertial data for link, using mass=1, localinertiadiagonal = 1,1,1b3Warning[examples/B.cpp,126]:
top"""
    assert remarks(harmless) == remarks("") == ""
    assert remarks(UNREAD + harmless) == remarks(UNREAD) != ""
    assert "cannot extract mesh from '/a b/c.stl'" in remarks(harmless + UNREAD)
