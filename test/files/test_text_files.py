# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Text files that users write: the program that saved them, and its line ends, change nothing."""

import itertools

import pytest
from user_files import OTHERS, ROUTE, YAMLS

from trackres_ros.errors import InputError
from trackres_ros.files.documents import read_yaml
from trackres_ros.files.resources import config_dir
from trackres_ros.route.table import read_route
from trackres_ros.vehicle.writing.vehicle_file import open_document

ENDS = ("\n", "\r\n", "\r")


@pytest.mark.parametrize("kind", [*YAMLS, *OTHERS])
def test_line_ends_and_a_byte_order_mark_change_nothing(tmp_path, kind):
    read, text = (YAMLS | OTHERS)[kind]
    path = tmp_path / "given.csv"
    path.write_text(text)
    right = read(path)
    for end, mark, last in itertools.product(ENDS, ("", "\ufeff"), (True, False)):
        path.write_bytes((mark + (text if last else text.rstrip("\n")).replace("\n", end)).encode())
        assert read(path) == right, (end, mark, last)


def test_a_diagnosis_can_change_a_vehicle_file_of_any_editor(tmp_path):
    text = (config_dir() / "husky.yaml").read_text()
    for end in ENDS:
        (tmp_path / "v.yaml").write_bytes(("\ufeff" + text.replace("\n", end)).encode())
        document = open_document(tmp_path / "v.yaml")
        document.set(("title",), "other")
        (tmp_path / "w.yaml").write_text(document.text() or "")
        assert read_yaml(tmp_path / "w.yaml") == {**read_yaml(tmp_path / "v.yaml"), "title": "other"}


@pytest.mark.parametrize("row", ['"' + "9" * 200_000 + '"', "47,8,90\0,0.01,0.002,3", "47;8;90;1;1;1"])
def test_a_damaged_row_of_a_route_is_one_line(tmp_path, row):
    path = tmp_path / "route.csv"
    path.write_text(ROUTE + row)
    with pytest.raises(InputError) as error_info:
        read_route(path)
    assert f"{path}, line" in str(error_info.value)
