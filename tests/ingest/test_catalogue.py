"""The catalogue: what a DBC must have, and the error that names what it lacks."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import pytest

from estimation.errors import CatalogueError
from ingest.catalogue import default_catalogue, load_catalogue

TEXT = (files("ingest") / "dbc" / "treadwatch.dbc").read_text()


def test_shipped_catalogue_is_the_predefined_connection_set() -> None:
    catalogue = default_catalogue()
    assert catalogue.sample_interval_ns == 4_000_000
    assert catalogue.wheelset_nodes == (1, 2, 3, 4, 5, 6, 7, 8)
    for node in catalogue.wheelset_nodes:
        assert catalogue.find("EMERGENCY", node).arbitration_id == 0x080 + node
        assert catalogue.find("ACCELERATION", node).arbitration_id == 0x180 + node
        assert catalogue.find("STATUS", node).arbitration_id == 0x280 + node
        assert catalogue.find("HEARTBEAT", node).arbitration_id == 0x700 + node
    vehicle = {"MOTION": 0x190, "PLACE": 0x290, "POSITION": 0x390}
    assert {kind: catalogue.find(kind, 16).arbitration_id for kind in vehicle} == vehicle
    assert (catalogue.find("SYNC").arbitration_id, catalogue.find("TIME").arbitration_id) == (0x080, 0x100)


def test_all_wheelset_nodes_speak_alike() -> None:
    catalogue = default_catalogue()
    for kind in ("ACCELERATION", "STATUS", "EMERGENCY", "HEARTBEAT"):
        assert len({catalogue.find(kind, node).signals for node in catalogue.wheelset_nodes}) == 1


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("SG_ speed : 0|16@1+", "SG_ speed : 7|16@0+", "MOTION_16.speed"),  # big endian
        ("SG_ speed :", "SG_ velocity :", "MOTION_16"),
        ('BA_ "GenMsgCycleTime" BO_ 128 4;', "", "SYNC"),
        ('BA_ "InvalidRawValue" SG_ 400 speed 65535;', 'BA_ "InvalidRawValue" SG_ 400 speed 7;', "MOTION_16.speed"),
        ("BO_ 912 POSITION_16:", "BO_ 912 position16:", "position16"),
        ("BO_ 912 POSITION_16:", "BO_ 912 ELSEWHERE_16:", "POSITION"),
        ("BO_ 912 POSITION_16:", "BO_ 2147484560 POSITION_16:", "POSITION_16"),  # 29 bits
    ],
)
def test_bad_catalogue_is_named_with_its_field(tmp_path: Path, old: str, new: str, field: str) -> None:
    path = tmp_path / "vehicle.dbc"
    assert old in TEXT
    text = TEXT.replace(old, new)
    if new.startswith("SG_ vel"):
        text = text.replace("SG_ 400 speed 65535;", "SG_ 400 velocity 65535;").replace(
            "400 speed 65535 ", "400 velocity 65535 "
        )
    if "2147484560" in new:
        text = text.replace(" 912 ", " 2147484560 ")
    path.write_text(text)
    with pytest.raises(CatalogueError) as caught:
        load_catalogue(path)
    assert caught.value.file == str(path)
    assert caught.value.field == field


@pytest.mark.parametrize("content", [b"BO_ nonsense", b"\xff\xfe\x00\x81" * 20, b"BO_ 1 SYNC: 1"])
def test_no_dbc_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "vehicle.dbc"
    path.write_bytes(content)
    with pytest.raises(CatalogueError, match=r"vehicle\.dbc"):
        load_catalogue(path)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match="nowhere"):
        load_catalogue(tmp_path / "nowhere.dbc")
