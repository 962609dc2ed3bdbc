"""A participant in headless Chromium: reads what a page asks, and answers it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from manip3d.serve import LocalServer
from manip3d.study import Study, StudyFolder
from manip3d.study._engine import study_server
from manip3d.viewer import _chromium
from waiting import wait_for


@contextmanager
def served(study: Study, folder: StudyFolder, port: int = 0) -> Iterator[LocalServer]:
    """Serve a study."""
    with study_server(study, folder, port=port) as server:
        yield server


class Participant:
    """A participant in front of a page of the study."""

    def __init__(self, tab: _chromium.Tab) -> None:
        self.tab = tab

    def begin(self, code: str) -> None:
        """Type a code and continue."""
        wait_for(lambda: self.tab.evaluate("!!document.querySelector('[name=participant]')"), code)
        self.tab.evaluate(
            f"document.querySelector('[name=participant]').value = {json.dumps(code)};"
            "document.querySelector('#continue').click()"
        )

    def step(self) -> dict[str, Any] | None:
        """Return the step that is shown and can be answered, or None."""
        text = self.tab.evaluate(
            "JSON.stringify((() => {"
            "const buttons = [...document.querySelectorAll('#form button')];"
            "const ready = buttons.length && buttons.every((b) => !b.disabled);"
            "return ready && !manip3dStudy.pending() ? manip3dStudy.step() : null; })())"
        )
        found: dict[str, Any] | None = json.loads(text)
        return found

    def next_step(self, after: str = "") -> dict[str, Any] | None:
        """Return the next step that can be answered; None at the end."""

        def there() -> dict[str, Any] | bool | None:
            if self.tab.evaluate("!!document.querySelector('#end')"):
                return True
            step = self.step()
            return step if step is not None and step["id"] != after else None

        found = wait_for(there, f"a step after {after}")
        return None if found is True else found

    def answer(self, values: dict[str, str]) -> None:
        """Fill in the form and send it through its inputs and buttons."""
        self.tab.evaluate(
            f"""(() => {{
            const values = {json.dumps(values)};
            for (const [name, value] of Object.entries(values)) {{
              const sides = [...document.querySelectorAll("button[data-side]")];
              const side = sides.find((button) => button.dataset.side === value);
              if (side) {{ side.click(); return; }}
              const inputs = [...document.querySelectorAll(`#form [name="${{name}}"]`)];
              const radio = inputs.find((i) => i.type === "radio" && i.value === value);
              if (radio) radio.click();
              else {{
                inputs[0].value = value;
                inputs[0].dispatchEvent(new Event("input", {{bubbles: true}}));
              }}
            }}
            document.querySelector("#continue").click();
            }})()"""
        )

    def answer_all(self, choose: Callable[[dict[str, Any]], dict[str, str]]) -> list[str]:
        """Answer to the end; return the ids of the steps."""
        seen: list[str] = []
        while (step := self.next_step(seen[-1] if seen else "")) is not None:
            self.answer(choose(step))
            seen.append(step["id"])
        return seen


def plain_answer(step: dict[str, Any]) -> dict[str, str]:
    """Return an answer to the questions that all studies ask, and a fixed one to others."""
    found = {}
    for field in step["fields"]:
        if field["type"] == "choice":
            found[field["name"]] = field["choices"][0][0]
        elif field["type"] == "text":
            found[field["name"]] = 'edges of the person, "quoted"\nand ä'
        else:
            found[field["name"]] = {"card_px": "330", "distance_cm": "55"}.get(field["name"], "30")
        if field["type"] == "scale":
            found[field["name"]] = "2"
    return found


def picture_of(tab: _chromium.Tab, path: Path) -> None:
    """Write a screenshot."""
    import base64

    tab.evaluate("new Promise(d => requestAnimationFrame(() => requestAnimationFrame(d)))")
    path.write_bytes(base64.b64decode(tab.send("Page.captureScreenshot", format="png")["data"]))
