"""CSVs of control points as surveyors write them, and what is said about those that cannot be read."""

import pytest

from panoloc.core.errors import OptionsError
from panoloc.core.survey.control_csv import ControlPoint, read_control_points

GRID = ControlPoint("A1", (691000.12, 5334000.5, 520.25))


@pytest.mark.parametrize(
    "text",
    [
        "name,x,y,z\nA1,691000.12,5334000.5,520.25\n",
        "\ufeffPunkt;Rechtswert [m];Hochwert [m];Höhe [m]\r\nA1;691000,12;5334000,5;520,25\r\n",
        "Nr\tEasting\tNorthing\tElevation\tCode\nA1\t691000.12\t5334000.5\t520.25\ttree\n",
        "A1,691000.12,5334000.5,520.25",
        "# measured on Monday\nA1 691000.12  5334000.5 520.25\n\n",
        "Point,N,E,H\nA1,5334000.5,691000.12,520.25\n",
        '"name","x","y","z"\n"A1","691000.12","5334000.5","520.25"\n',
    ],
)
def test_usual_forms_are_understood(text: str) -> None:
    assert read_control_points(text) == [GRID]


def test_latitudes_and_places_in_the_scan_are_read() -> None:
    text = "id,lat,lon,alt,map_x,map_y,map_z\nP,48.1,11.5,560.1,1,2,3\nQ,48.2,11.6,561,,,\n"
    first, second = read_control_points(text)
    assert first == ControlPoint("P", (48.1, 11.5, 560.1), True, (1.0, 2.0, 3.0))
    assert (second.known, second.position_m) == ((48.2, 11.6, 561.0), None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected lines with control points"),
        ("name,x,y,z\n", "below the header"),
        ("name,x,y\nA,1,2\n", "has no z"),
        ("a,b\nA,1\n", "has no name, x, y, z"),
        ("name,x,y,z\nA,1,2,3\nA,4,5,6\n", "line 3: expected each name once"),
        (
            "name,x,y,z\nA,1,2,three\nB,4,,6\n",
            "line 2: expected a number for z, got 'three'; line 3: expected a number for y, got nothing",
        ),
        ("name,lat,lon,h\nA,98,11,0\n", "line 2: expected a latitude up to 90"),
        ("name,x,y,z\n" + "\n".join(f"{n},a,b,c" for n in range(8)), "and 3 more lines"),
        ("\n".join(f"{n},1,2,3" for n in range(1001)), "at most 1000 points"),
    ],
)
def test_what_cannot_be_read_is_said_line_by_line(text: str, words: str) -> None:
    with pytest.raises(OptionsError, match=words):
        read_control_points(text)
