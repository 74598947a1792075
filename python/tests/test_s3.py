"""A page file in an object store, asked for with signed requests: `moto` stands for the store."""

from urllib.request import Request, urlopen

import boto3
import numpy as np
import pytest
import trex
from moto.server import ThreadedMotoServer


@pytest.fixture
def store(surface_file, monkeypatch):
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        "AWS_ACCESS_KEY_ID": "somebody",
        "AWS_SECRET_ACCESS_KEY": "verysecret",
        "AWS_DEFAULT_REGION": "eu-central-1",
    }.items():
        monkeypatch.setenv(name, value)
    endpoint = f"http://{host}:{port}"
    client = boto3.client("s3", endpoint_url=endpoint)
    client.create_bucket(Bucket="models", CreateBucketConfiguration={"LocationConstraint": "eu-central-1"})
    client.upload_file(str(surface_file), "models", "a b/surface.trex")
    yield endpoint, client
    trex.network()
    # The store outlives its server.
    urlopen(Request(f"{endpoint}/moto-api/reset", method="POST")).close()
    server.stop()


def test_rays_are_those_of_the_file_and_a_second_look_is_kept(surface_file, store, tmp_path):
    endpoint, client = store
    trex.network(s3_endpoint=endpoint, cache_dir=tmp_path / "kept", cache_limit="1GiB")
    origins = np.random.default_rng(1).uniform(-1, 1, (300, 3))
    with trex.open(surface_file) as near:
        low, high = np.array(near.bounds)
        origins = low + (origins + 1) / 2 * (high - low)
        directions = np.random.default_rng(2).normal(size=(300, 3))
        here = near.intersect(origins, directions)
    for _ in range(2):
        with trex.open("s3://models/a b/surface.trex") as far:
            there = far.intersect(origins, directions)
        np.testing.assert_array_equal(there.t_hit, here.t_hit)
        np.testing.assert_array_equal(there.triangle, here.triangle)
    assert list((tmp_path / "kept").glob("*/*.segment"))
    assert trex.verify("s3://models/a b/surface.trex")["verdict"] == "clean"


def test_what_is_not_there_is_told_without_credentials(store):
    endpoint, _ = store
    trex.network(s3_endpoint=endpoint)
    with pytest.raises(trex.TrexError) as told:
        trex.open("s3://models/absent.trex")
    assert "verysecret" not in str(told.value) and "somebody" not in str(told.value)
    assert told.value.code == "input-unreadable"


def test_a_file_that_was_replaced_is_not_read_on(surface_file, store):
    endpoint, client = store
    trex.network(s3_endpoint=endpoint)
    with trex.open("s3://models/a b/surface.trex", memory_limit="128MiB") as model:
        client.put_object(Bucket="models", Key="a b/surface.trex", Body=surface_file.read_bytes() + b"x")
        middle = np.array(model.bounds).mean(axis=0)
        with pytest.raises(trex.TrexError):
            model.intersect(np.tile(middle, (50, 1)), np.random.default_rng(3).normal(size=(50, 3)))
