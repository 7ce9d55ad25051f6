"""Where a webhook may not lead."""

from __future__ import annotations

import ipaddress

import pytest

from api.webhooks.sending import RefusedTargetError, check, is_public, networks_of, parsed
from estimation.errors import ParameterError

PRIVATE = [
    "127.0.0.1", "127.8.9.1", "0.0.0.1", "10.0.0.1", "172.16.3.4", "192.168.1.1", "169.254.169.254", "100.64.0.1",
    "100.100.100.200", "168.63.129.16", "192.0.0.8", "192.0.2.1", "192.88.99.1", "198.18.0.1", "224.0.0.1",
    "239.1.1.1", "240.0.0.1", "255.255.255.255", "::", "::1", "::127.0.0.1", "::ffff:127.0.0.1", "::ffff:10.0.0.1",
    "64:ff9b::7f00:1", "64:ff9b::a9fe:a9fe", "64:ff9b:1::1", "fc00::1", "fd00:ec2::254", "fe80::1", "fec0::1",
    "ff02::1", "2001::1", "2001:db8::1", "2002:7f00:1::", "2002:808:808::1", "5f00::1", "100::1",
]  # fmt: skip
PRIVATE.append(str(ipaddress.IPv4Address(0)))
PUBLIC = ["93.184.215.14", "1.1.1.1", "2606:4700::1111", "::ffff:8.8.8.8", "64:ff9b::808:808"]


@pytest.mark.parametrize("text", PRIVATE)
def test_what_is_not_public_is_refused_unless_its_network_is_named(text: str) -> None:
    address, url = ipaddress.ip_address(text), parsed("https://receiver.example/")
    assert not is_public(address)
    with pytest.raises(RefusedTargetError, match="not public"):
        check(url, [ipaddress.ip_address("1.1.1.1"), address], ())
    mapped = getattr(address, "ipv4_mapped", None) or address
    nat64 = ipaddress.ip_address(address.packed[-4:]) if text.startswith("64:ff9b::") else mapped
    check(url, [ipaddress.ip_address("1.1.1.1"), address], networks_of(f"203.0.113.0/24, {nat64}"))


@pytest.mark.parametrize("text", PUBLIC)
def test_what_is_public_is_not_refused_but_for_plain_http(text: str) -> None:
    address = ipaddress.ip_address(text)
    assert is_public(address)
    check(parsed("https://receiver.example/"), [address], ())
    with pytest.raises(RefusedTargetError, match="use https://"):
        check(parsed("http://receiver.example/"), [address], networks_of("10.0.0.0/8"))


def test_a_name_without_an_address_is_refused() -> None:
    with pytest.raises(RefusedTargetError, match="no address"):
        check(parsed("https://receiver.example/"), [], ())


@pytest.mark.parametrize(
    "url",
    [
        "https://", "https:///path", "ftp://receiver.example/", "receiver.example", "https://user@receiver.example/",
        "https://user:geheim@receiver.example/", "https://@receiver.example/", "https://a b/", "https://receiver.example/#f",
        "https://receiver.example:22/", "https://receiver.example:0/", "https://receiver.example:99999/",
        "https://[fe80::1%25eth0]/", "https://127.0.0.1\\@receiver.example/", "https://receiver.example/\u0000",
        "https://receiver.example/ x", "https://" + "a" * 3000, "https://[::1", "javascript:alert(1)",
    ],
)  # fmt: skip
def test_what_is_no_url_to_send_to(url: str) -> None:
    with pytest.raises(ParameterError) as refused:
        parsed(url)
    assert refused.value.field == "url"
    assert "geheim" not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["https://receiver.example/x?y=1", "http://10.0.0.1:8080/", "https://[2606:4700::1111]/"]
)
def test_what_is_one(url: str) -> None:
    assert str(parsed(url)) == url


def test_networks_of_a_setting() -> None:
    assert networks_of(None) == networks_of(" , ") == ()
    with pytest.raises(ParameterError, match="TREADWATCH_WEBHOOK_NETWORKS"):
        networks_of("10.0.0.0/8, loopback")
    with pytest.raises(ParameterError):
        networks_of("10.0.0.1/8")
