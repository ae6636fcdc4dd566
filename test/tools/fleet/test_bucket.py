# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings in a bucket, of a server that is there, on loopback."""

import pytest

from trackres_ros.tools.fleet.recordings import find_recordings
from trackres_ros.tools.fleet.task import Task, analyse
from trackres_ros.tools.fleet.vehicles import one_vehicle

pytest.importorskip("s3fs")
moto = pytest.importorskip("moto.server")

pytestmark = pytest.mark.filterwarnings("default")  # libraries of others warn each other


@pytest.fixture
def bucket(driven, monkeypatch):
    """A bucket with the recordings of a vehicle; gives its URL."""
    import fsspec
    import s3fs

    server = moto.ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    settings = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "x", "AWS_SECRET_ACCESS_KEY": "x",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    for key, value in settings.items():
        monkeypatch.setenv(key, value)
    s3fs.S3FileSystem.clear_instance_cache()
    system = fsspec.filesystem("s3")
    name = f"months-{port}"  # buckets outlive the server within a process
    system.mkdir(name)
    system.put(str(driven / "recordings" / "truck-01"), f"{name}/truck-01", recursive=True)
    yield f"s3://{name}"
    server.stop()
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.mark.long
def test_recordings_in_a_bucket_are_analysed_like_files(bucket, driven):
    found = list(find_recordings([bucket]))
    assert [one.url for one in found] == [f"{bucket}/truck-01/drive_000{n}.csv" for n in (1, 2, 3)]
    assert len({one.stamp for one in found}) == 3
    assert [one.url for one in find_recordings([f"{bucket}/*/drive_0002.csv"])] == [found[1].url]
    vehicle = one_vehicle("xgd24d", None).vehicles["xgd24d"]
    there, here = (
        analyse(Task(url, "1", vehicle)) for url in (found[0].url, str(driven / "recordings" / "truck-01" / "drive_0001.csv"))
    )
    assert there["status"] == "good", there["reason"]
    of_place = ("url", "took_s", "notes")
    assert {key: value for key, value in there.items() if key not in of_place} == {
        k: v for k, v in here.items() if k not in of_place
    }
    assert found[0].url in there["notes"][0]  # and no word of where it was fetched to


def test_a_missing_or_refusing_bucket_does_not_stop_the_others(bucket, monkeypatch):
    missing, *others = find_recordings(["s3://nowhere/x", bucket])
    assert missing.problem
    assert len(others) == 3
    import s3fs

    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    s3fs.S3FileSystem.clear_instance_cache()
    (refused,) = find_recordings([bucket])
    assert refused.problem
    assert "\n" not in refused.problem
