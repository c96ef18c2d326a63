"""A stand-in for VTube Studio: its public API on a WebSocket (README and ErrorID.cs of DenchiSoft/VTubeStudio)."""

from __future__ import annotations

import contextlib
import json
import re
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from websockets.sync.server import ServerConnection, serve

DEFAULTS = {
    *(f"{part}{axis}" for part in ("FaceAngle", "FacePosition") for axis in "XYZ"),
    *(f"Eye{side}{axis}" for side in ("Left", "Right") for axis in "XY"),
    *("EyeOpenLeft", "EyeOpenRight", "MouthOpen", "MouthSmile", "Brows"),
}


class RefusedError(Exception):
    """An APIError: errorID and message."""


@dataclass
class VTubeStudio:
    """What has been allowed, asked, created and injected."""

    allow: bool = True  # the user's answer to a plugin that asks
    taken: str = ""  # a parameter that another plugin controls
    tokens: dict[str, tuple[str, str]] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    created: set[str] = field(default_factory=set)
    injected: list[dict[str, float]] = field(default_factory=list)
    address: str = ""

    def serve(self, connection: ServerConnection) -> None:
        """Answer a client."""
        session = {"authenticated": False}
        for message in connection:
            request = json.loads(message)
            kind = request["messageType"]
            self.asked.append(kind)
            try:
                answer = {"messageType": kind.replace("Request", "Response"), "data": self.answer(request, session)}
            except RefusedError as refused:
                number, reason = refused.args
                answer = {"messageType": "APIError", "data": {"errorID": number, "message": reason}}
            head = {"apiName": "VTubeStudioPublicAPI", "apiVersion": "1.0", "timestamp": 1625405710728}
            connection.send(json.dumps({**head, "requestID": request["requestID"], **answer}))

    def answer(self, request: dict[str, Any], session: dict[str, bool]) -> dict[str, Any]:
        """The data of the response."""
        kind, data = request["messageType"], request["data"]
        refuse_if(request["apiName"] != "VTubeStudioPublicAPI", 3, "The API name is invalid.")
        refuse_if(request["apiVersion"] != "1.0", 4, "The API version is invalid.")
        refuse_if(not re.fullmatch("[!-~]{1,64}", request["requestID"]), 5, "The request ID is invalid.")
        if kind == "APIStateRequest":
            return {"active": True, "currentSessionAuthenticated": session["authenticated"]}
        if kind.startswith("Authentication"):
            plugin = (data["pluginName"], data["pluginDeveloper"])
            refuse_if(not all(3 <= len(name) <= 32 for name in plugin), 52, "A plugin name is invalid.")
            if kind == "AuthenticationRequest":
                session["authenticated"] = self.tokens.get(data["authenticationToken"]) == plugin
                return {"authenticated": session["authenticated"], "reason": "Token valid or not."}
            refuse_if(not self.allow, 50, "User has denied API access for your plugin.")
            token = f"token-{len(self.tokens)}"
            self.tokens[token] = plugin
            return {"authenticationToken": token}
        refuse_if(not session["authenticated"], 8, "This request requires authentication.")
        if kind == "ParameterCreationRequest":
            return self.create(data)
        refuse_if(kind != "InjectParameterDataRequest", 7, "The request type is unknown.")
        return self.inject(data)

    def create(self, data: dict[str, Any]) -> dict[str, Any]:
        """Add a parameter."""
        name = data["parameterName"]
        refuse_if(not re.fullmatch("[A-Za-z0-9]{4,32}", name), 350, f"{name}: not a name.")
        refuse_if(not data["min"] <= data["defaultValue"] <= data["max"], 351, f"{name}: values invalid.")
        refuse_if(len(data["explanation"]) >= 256, 353, f"{name}: explanation too long.")
        refuse_if(name in DEFAULTS, 354, f"{name}: the name of a default parameter.")
        self.created.add(name)
        return {"parameterName": name}

    def inject(self, data: dict[str, Any]) -> dict[str, Any]:
        """Set parameters."""
        values = {each["id"]: each["value"] for each in data["parameterValues"]}
        refuse_if(not values, 450, "No data.")
        refuse_if(data["mode"] != "set" or data["faceFound"] is not True, 455, "The mode is unknown.")
        for name, value in values.items():
            refuse_if(name not in DEFAULTS | self.created, 453, f"{name}: no such parameter.")
            refuse_if(not -1e6 <= value <= 1e6, 451, f"{name}: value invalid.")
            refuse_if(name == self.taken, 454, f"{name}: controlled by another plugin.")
        self.injected.append(values)
        return {}


def refuse_if(wrong: bool, number: int, reason: str) -> None:
    """Raise the error of a request that is wrong."""
    if wrong:
        raise RefusedError(number, reason)


@contextlib.contextmanager
def vtube_studio(**settings: Any) -> Iterator[VTubeStudio]:
    """A running stand-in."""
    studio = VTubeStudio(**settings)
    with serve(studio.serve, "127.0.0.1", 0) as server:
        studio.address = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield studio
        finally:
            server.shutdown()
            thread.join()
