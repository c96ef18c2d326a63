"""What pages of other sites and other machines cannot do to the three local servers."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from fastapi import WebSocket
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from talkingeyes.apps.viewer.local_server import ACCESS, ANY_ADDRESS, create_app
from talkingeyes.core.errors import InputError

LOCAL = "http://127.0.0.1:8000"
FOREIGN = {"origin": "https://elsewhere.example"}


def app(host: str = "127.0.0.1", stream_origins: tuple[str, ...] = ()) -> Any:
    """An application as the servers make it, with a page, a change of state, and a socket."""
    made = create_app(host, stream_origins)

    @made.get("/")
    def page() -> str:
        return "page"

    @made.post("/change")
    def change() -> str:
        return "changed"

    async def socket(connection: WebSocket) -> None:
        await connection.accept()
        await connection.send_text("hello")
        await asyncio.sleep(0)
        await connection.close()

    made.add_api_websocket_route("/stream", socket)
    return made


def test_the_page_itself_may_change_state() -> None:
    client = TestClient(app(), base_url=LOCAL)
    assert client.post("/change", headers={"origin": LOCAL}).json() == "changed"
    assert client.post("/change").json() == "changed"  # a program without a browser
    with client.websocket_connect("ws://127.0.0.1:8000/stream", headers={"origin": LOCAL}) as socket:
        assert socket.receive_text() == "hello"


def test_pages_of_other_sites_are_refused() -> None:
    client = TestClient(app(), base_url=LOCAL)
    for origin in ("https://elsewhere.example", "http://127.0.0.1:9999", "null"):
        assert client.post("/change", headers={"origin": origin}).status_code == 403
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("ws://127.0.0.1:8000/stream", headers=FOREIGN):
        pass


def test_pages_of_a_named_origin_may_open_sockets_and_nothing_else() -> None:
    page = "http://127.0.0.1:9999"
    client = TestClient(app(stream_origins=(page,)), base_url=LOCAL)
    with client.websocket_connect("ws://127.0.0.1:8000/stream", headers={"origin": page}) as socket:
        assert socket.receive_text() == "hello"
    assert client.post("/change", headers={"origin": page}).status_code == 403
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("ws://127.0.0.1:8000/stream", headers=FOREIGN):
        pass
    for wrong in ("127.0.0.1:9999", f"{page}/", f"{page}/page.html", "file://", "*"):
        with pytest.raises(InputError, match="origin: should be as http"):
            create_app(stream_origins=(wrong,))


@pytest.mark.parametrize("host", ["127.0.0.1", *ANY_ADDRESS])
def test_only_names_of_this_machine_are_answered(host: str) -> None:
    client = TestClient(app(host), base_url=LOCAL)
    for name in ("elsewhere.example", "testserver", "127.0.0.1.elsewhere.example"):
        assert client.get("/", headers={"host": name}).status_code == 400


@pytest.mark.parametrize("host", ["192.168.0.7", *ANY_ADDRESS])
def test_other_machines_need_the_token_of_the_printed_address(host: str) -> None:
    made = app(host)
    client = TestClient(made, base_url=LOCAL)
    token = made.state.access_token
    assert client.get("/").status_code == 403
    assert client.get("/", params={ACCESS: "é" + token}).status_code == 403
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("ws://127.0.0.1:8000/stream"):
        pass
    opened = client.get("/", params={ACCESS: token})
    assert opened.status_code == 200
    assert "HttpOnly; SameSite=Strict" in opened.headers["set-cookie"]
    assert client.post("/change").json() == "changed"  # the cookie is kept
    with client.websocket_connect("ws://127.0.0.1:8000/stream") as socket:
        assert socket.receive_text() == "hello"


def test_the_chosen_host_name_is_answered() -> None:
    made = app("studio.example")
    client = TestClient(made, base_url="http://studio.example:8010")
    assert client.get("/", params={ACCESS: made.state.access_token}).status_code == 200


def test_this_machine_needs_no_token() -> None:
    assert app().state.access_token is None
