"""The page for browsers: what is served where, and what it may do."""

import re

import pytest

from pica_server.pages import WebPage

pytestmark = pytest.mark.unit

FILES = {"index.html": '<script src="web/main.js"></script>', "main.js": "export {};"}


@pytest.mark.parametrize("path", ["/", "/standup", "/standup?tile=Ada", "/v1.2_b-c"])
def test_every_name_of_a_room_shows_the_page(path: str) -> None:
    page = WebPage(FILES).answer(path, "relay.example")
    assert page is not None
    assert page.text.startswith("<script")
    assert page.headers["Cache-Control"] == "no-cache"


@pytest.mark.parametrize("path", ["/a/b", "/web/main.js", "//evil.example", "/<b>", "/../main.js"])
def test_nothing_else_is_there(path: str) -> None:
    assert WebPage(FILES).answer(path, "relay.example") is None


def test_files_are_kept_for_good_under_a_name_that_changes_with_them() -> None:
    folders = []
    for script in ("1", "2"):
        page = WebPage({**FILES, "main.js": script})
        index = page.answer("/", "relay.example")
        assert index is not None
        (path,) = re.findall(r'src="(.*)"', index.text)
        file = page.answer(f"/{path}", "relay.example")
        assert file is not None
        assert file.text == script
        assert file.content_type.startswith("text/javascript")
        assert "immutable" in file.headers["Cache-Control"]
        # Of a worker, which sees a camera's pictures: it can send nothing.
        assert file.headers["Content-Security-Policy"].startswith("default-src 'none'; script-src")
        folders.append(path)
    assert folders[0] != folders[1]


def test_modules_are_asked_for_at_once_but_those_that_come_later() -> None:
    page = WebPage({**FILES, "index.html": "<head></head>", "face.js": "", "draw.js": ""})
    index = page.answer("/", "relay.example")
    assert index is not None
    found = re.findall(r'<link rel="modulepreload" href="web-\w+/(.*?)" />', index.text)
    assert found == ["draw.js", "main.js"]


@pytest.mark.parametrize("host", ["relay.example:8765", "[::1]:8765", "evil; script-src *", ""])
def test_the_page_may_connect_to_its_relay_alone(host: str) -> None:
    page = WebPage(FILES).answer("/", host)
    assert page is not None
    policy = page.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self';")
    assert "frame-ancestors 'none'" in policy
    (allowed,) = re.findall(r"connect-src ([^;]*);", policy)
    is_name = ";" not in host and host
    assert allowed == (f"'self' ws://{host} wss://{host}" if is_name else "'self'")
