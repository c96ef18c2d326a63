"""The viewer's page as one HTML file that opens without a server, to be sent or archived.

All files of the page are embedded: scripts as modules of an import map, data as `embedded`, both as data URLs.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping

from talkingeyes.apps.viewer.assets import Asset

MODULES = ("stage.js", "three.js", "timeline.js")


def standalone_page(files: Mapping[str, Asset]) -> str:
    """The page of `server.page_files` with everything embedded."""
    text = {name: files[name].content.decode() for name in ("", "style.css", "view.js", *MODULES)}
    text["stage.js"] = text["stage.js"].replace('"./three.js"', '"three"')  # data URLs have no relative imports
    imports = {f"./{name}": _data_url(Asset(text[name].encode(), files[name].media)) for name in MODULES}
    imports["three"] = imports.pop("./three.js")
    data = {name: _data_url(each) for name, each in files.items() if name not in text}
    page = text[""].replace('<link rel="stylesheet" href="style.css" />', f"<style>{text['style.css']}</style>")
    return page.replace(
        '<script type="module" src="view.js"></script>',
        f'<script type="importmap">{json.dumps({"imports": imports})}</script>\n'
        f"<script>globalThis.embedded = {json.dumps(data)};</script>\n"
        f'<script type="module">{text["view.js"]}</script>',
    )


def _data_url(file: Asset) -> str:
    return f"data:{file.media};base64,{base64.b64encode(file.content).decode()}"
