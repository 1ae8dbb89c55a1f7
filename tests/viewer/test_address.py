import socket

import pytest

pytest.importorskip("viser", reason="the extra `view` is not installed")

from collaborative_gym.viewer.guard import free_port, is_loopback, name_for_browser


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.0.1", "::1", "localhost"])
def test_only_this_machine_reaches_a_loopback_address(host):
    assert is_loopback(host)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.1", "8.8.8.8"])
def test_others_reach_another_address(host):
    assert not is_loopback(host)


def test_a_browser_gets_an_address_that_it_can_open():
    hosts = ["127.0.0.1", "::1", "0.0.0.0", "::"]
    assert [name_for_browser(host) for host in hosts] == [
        "127.0.0.1",
        "[::1]",
        "localhost",
        "localhost",
    ]


def test_a_port_that_is_taken_gives_way_to_the_next():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert free_port("127.0.0.1", port) > port
    assert free_port("127.0.0.1", port) == port
    assert free_port("127.0.0.1", 0) == 0


def test_where_it_cannot_listen_it_says_why():
    with pytest.raises(
        ValueError, match=r"cannot listen on 192.0.2.7, port 8080: Cannot"
    ):
        free_port("192.0.2.7", 8080)
    with pytest.raises(ValueError, match=r"cannot listen on no.host, port 8080: "):
        free_port("no.host", 8080)


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_does_not_exist_is_refused(port):
    with pytest.raises(ValueError, match=f"between 0 and 65535, got {port}"):
        free_port("127.0.0.1", port)
