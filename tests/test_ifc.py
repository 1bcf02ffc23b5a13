"""Building models: a space, its volume, and the materials of what bounds it."""

from pathlib import Path

import numpy as np
import pytest

from rtcal.io import mesh
from rtcal.support.errors import DataError
from tests.conftest import also

pytest.importorskip("ifcopenshell", reason="needs the extra ifc")
pytest.importorskip("shapely", reason="needs the extra ifc")

# A space of 4 m x 5 m x 3 m at (10, 0, 0) m, drawn in mm: a brick wall with a door at x = 0, a carpet,
# and an opening to the next space at y = 5 m. Nothing is said of the other three faces.
MODEL = Path(__file__).with_name("space.ifc").read_text(encoding="utf-8")
SECOND = "#70=IFCSPACE('0ZvctVUKr0kugbFTf53O9L',$,'2',$,$,#12,#18,'Hall',.ELEMENT.,.INTERNAL.,$);"


def written(folder, name="Study", more=""):
    path = folder / "house.ifc"
    path.write_text(MODEL.replace("'NAME'", f"'{name}'").replace("MORE", more), encoding="utf-8")
    return path


def test_a_space_has_its_volume_and_the_materials_that_bound_it(tmp_path):
    done = mesh.room(written(tmp_path))
    assert done.geometry.volume == pytest.approx(60)
    areas = done.geometry.areas
    assert areas.pop("brick") == pytest.approx(15 - 1.8)
    assert areas.pop("Oak door:900") == pytest.approx(1.8)
    assert areas.pop("Carpet") == pytest.approx(20)
    assert areas.pop("opening") == pytest.approx(12)
    assert areas == {"ceiling": pytest.approx(20), "wall": pytest.approx(15 + 12)}
    assert done.geometry.vertices.min(axis=0) == pytest.approx([10, 0, 0])


def test_of_several_spaces_one_is_named(tmp_path, rtcal):
    path = written(tmp_path, more=SECOND)
    with pytest.raises(DataError, match=r'several spaces; name one with --space: "1 Study", "2 Ha'):
        mesh.room(path)
    with pytest.raises(DataError, match='--space "Attic" is no space of the model'):
        mesh.room(path, space="Attic")
    for name in ("1", "Study", "1 Study"):
        assert mesh.room(path, space=name).geometry.volume == pytest.approx(60)
    # Nothing is said of what bounds the second one.
    assert set(mesh.room(path, space="Hall").geometry.areas) == {"wall", "floor", "ceiling"}
    assert "brick" in rtcal("import", "check", path, "--space", "Study")


def outlined(folder, corners, listed=False):
    """The model with an outline of its space, in mm, as points or as one list of them."""
    lines = [f"#{200 + i}=IFCCARTESIANPOINT(({x!r},{y!r}));" for i, (x, y) in enumerate(corners)]
    lines.append(f"#300=IFCPOLYLINE(({','.join(f'#{200 + i}' for i in range(len(corners)))}));")
    if listed:
        points = ",".join(f"({x!r},{y!r})" for x, y in corners)
        lines = [
            f"#299=IFCCARTESIANPOINTLIST2D(({points}));",
            "#300=IFCINDEXEDPOLYCURVE(#299,$,.F.);",
        ]
    lines.append("#301=IFCARBITRARYCLOSEDPROFILEDEF(.AREA.,$,#300);")
    path = written(folder, more="\n".join(lines))
    text = path.read_text(encoding="utf-8")
    text = text.replace("IFCEXTRUDEDAREASOLID(#15,", "IFCEXTRUDEDAREASOLID(#301,")
    path.write_text(text, encoding="utf-8")
    return path


SQUARE = [(0.0, 0.0), (4000.0, 0.0), (4000.0, 5000.0), (0.0, 5000.0)]


@pytest.mark.parametrize("listed", [False, True])
@pytest.mark.parametrize("gap", [0.0, 1e-4, 0.03, 0.4, 2.5, 9.0])
@pytest.mark.parametrize("first", [0, *also(1, 2, 3)])
def test_an_outline_that_is_nearly_closed_is_closed(tmp_path, gap, first, listed):
    ring = SQUARE[first:] + SQUARE[:first]
    (x, y), (xn, yn) = ring[0], ring[-1]
    along = np.array([xn - x, yn - y]) / np.hypot(xn - x, yn - y)
    end = (float(x + gap * along[0]), float(y + gap * along[1]))
    done = mesh.room(outlined(tmp_path, [*ring, end], listed))
    assert done.volume == pytest.approx(60, rel=1e-9)
    (note,) = [n for n in done.notes if "outline" in n] or [""]
    assert note == (f"its outline was open by {gap:.2g} mm and is closed (--weld)" if gap else "")


@pytest.mark.parametrize(
    ("corners", "rule"),
    [
        (
            [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3], SQUARE[0]],
            "crosses itself at x = 2 m and y = 2.5 m",
        ),
        ([SQUARE[0], SQUARE[1], SQUARE[0]], "its outline has 2 corners; at least three are needed"),
    ],
)
def test_an_outline_that_bounds_no_floor_is_refused_in_own_words(tmp_path, corners, rule):
    path = outlined(tmp_path, corners)
    with pytest.raises(DataError, match=f'space "1 Study": .*{rule}'):
        mesh.room(path)


def test_what_is_no_model_of_a_room_is_refused(tmp_path):
    path = written(tmp_path)
    with pytest.raises(DataError, match="contains its unit: leave --unit out"):
        mesh.room(path, unit=0.1)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("#19=IFCSPACE", "#19=IFCSPACETYPE_"), encoding="utf-8")
    with pytest.raises(DataError, match=r"no space \(IfcSpace\)|cannot be read as IFC"):
        mesh.room(path)
    path.write_bytes(b"\x00\x01 nonsense")
    with pytest.raises(DataError, match=r"cannot be read as IFC|has no space"):
        mesh.room(path)


def changed(folder, old, new):
    path = written(folder)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


OF_FACTOR = (
    "#9=IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.);\n#80=IFCDIMENSIONALEXPONENTS(1,0,0,0,0,0,0);\n"
    "#81=IFCMEASUREWITHUNIT(IFCLENGTHMEASURE(0.),#9);\n"
    "#6=IFCCONVERSIONBASEDUNIT(#80,.LENGTHUNIT.,'X',#81);"
)
SHAPE = "#17=IFCSHAPEREPRESENTATION(#5,'Body','SweptSolid',(#16));"
PLACED = "#12=IFCLOCALPLACEMENT($,#11);"
MILLI = "#6=IFCSIUNIT(*,.LENGTHUNIT.,.MILLI.,.METRE.);"
DEEP = "\n".join(
    [f"#{1000 + i}=IFCLOCALPLACEMENT(#{1001 + i},#11);" for i in range(20000)]
    + ["#21000=IFCLOCALPLACEMENT($,#11);"]
)


@pytest.mark.parametrize(
    ("old", "new", "rule"),
    [
        # The process ended with a fault in the library, or never.
        (PLACED, "#12=IFCLOCALPLACEMENT(#12,#11);", "#(12|90) refers to itself"),
        (
            PLACED,
            "#12=IFCLOCALPLACEMENT(#90,#11);\n#90=IFCLOCALPLACEMENT(#12,#11);",
            "#(12|90) refers to itself",
        ),
        (
            PLACED,
            f"#12=IFCLOCALPLACEMENT(#1000,#11);\n{DEEP}",
            "entities refer to each other in a row",
        ),
        (
            SHAPE,
            "#91=IFCBOOLEANRESULT(.UNION.,#91,#16);\n"
            "#17=IFCSHAPEREPRESENTATION(#5,'Body','CSG',(#91));",
            "#91 refers to itself",
        ),
        (
            SHAPE,
            "#92=IFCREPRESENTATIONMAP(#4,#17);\n"
            "#93=IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,#1,$,$);\n#94=IFCMAPPEDITEM(#92,#93);\n"
            "#17=IFCSHAPEREPRESENTATION(#5,'Body','MappedRepresentation',(#94));",
            "refers to itself",
        ),
        (MILLI, OF_FACTOR.replace("(0.),#9", "(2.),#6"), "refers to itself"),
        # A traceback.
        (MILLI, OF_FACTOR, "its unit of length is 0 m, but must be above 0"),
        # A room without what stood in the part that is lost.
        ("ENDSEC;\nEND-ISO-10303-21;", "", "its last line"),
    ],
    ids=["self", "two", "deep", "boolean", "mapped", "unit", "zero", "cut off"],
)
def test_content_that_ends_the_process_or_is_lost_is_refused(tmp_path, old, new, rule):
    with pytest.raises(DataError, match=rule):
        mesh.room(changed(tmp_path, old, new))
