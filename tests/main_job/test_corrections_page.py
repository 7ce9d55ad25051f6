"""The commands of docs/corrections.md run as they are written, and do what the page says."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from page_place import Place
from tiny_fleet import DEAD, WORN

PAGE = Path(__file__).parents[2] / "docs" / "corrections.md"


def lines() -> list[str]:
    return re.findall(r"^    (treadwatch .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.slow
def test_the_page_is_run_line_by_line(place: Place) -> None:
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    right = place.windows()
    assert {state for found in right.values() for _, state, _ in found} == {"estimated"}
    for line in lines():
        if line.startswith("treadwatch ingest"):
            shutil.rmtree(place.data / "windows")
        done = place(line)
        if " void " in line:
            place("treadwatch estimate")
            assert place.windows() == right | {WORN: []}
        elif " restore " in line:
            place("treadwatch estimate")
            assert place.windows() == right
        elif " history " in line:
            assert re.search(r"voided mounting.*was WS-1012.*\n.*restored mounting.*it was right", done.stdout)
        elif line.startswith("treadwatch ingest"):
            assert len(list((place.data / "windows").rglob("*.window"))) == sum(map(len, right.values()))
        elif line.startswith("treadwatch reassemble"):
            assert "new 0, changed 0, removed 0, healed 0" in done.stdout
    assert place.windows() == right


@pytest.mark.slow
def test_lost_windows_that_a_corrected_track_file_needs_are_made_again(place: Place) -> None:
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    right = place.windows()
    for file in (place.data / "windows").rglob("*.window"):
        file.unlink()
    entries = json.loads((place.folder / "registry.json").read_text(encoding="utf-8"))
    track = place.folder / entries["track_sections"][0]["alignment"]["file"]
    head, first, *rest = track.read_text(encoding="utf-8").splitlines()
    s, alignment, *others = first.split(",")
    corrected = [head, ",".join([s, f"{float(alignment) + 0.01:.4f}", *others]), *rest]
    track.write_text("\n".join(corrected) + "\n", encoding="utf-8")
    place("treadwatch registry load registry.json")
    place("treadwatch estimate")  # finds that the files are lost
    place("treadwatch estimate")
    assert place.windows() == right


@pytest.mark.slow
def test_two_wheelsets_that_were_swapped_in_the_file_are_put_right_by_the_file(place: Place) -> None:
    registry = place.folder / "registry.json"
    right = json.loads(registry.read_text(encoding="utf-8"))
    other = {WORN: DEAD, DEAD: WORN}
    mileage = {one["wheelset"]: one["wheelset_mileage_km"] for one in right["mountings"]}
    wrong = right | {
        "mountings": [
            one | {"wheelset": other[one["wheelset"]], "wheelset_mileage_km": mileage[other[one["wheelset"]]]}
            for one in right["mountings"]
        ]
    }
    registry.write_text(json.dumps(wrong), encoding="utf-8")
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    mistaken = place.windows()
    registry.write_text(json.dumps(right), encoding="utf-8")
    place("treadwatch registry load registry.json")
    place("treadwatch estimate")
    corrected = place.windows()
    place("treadwatch reassemble --vehicle N-101")
    assert place.windows() == corrected
    assert {state for found in corrected.values() for _, state, _ in found} == {"estimated"}
    assert not {one[0] for found in corrected.values() for one in found} & {
        one[0] for found in mistaken.values() for one in found
    }
