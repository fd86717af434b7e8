#!/usr/bin/env python3
"""Opens report pages in headless Chromium and checks them: no error, no request, nothing wider than the screen, words that can be read, a viewer that
zooms, moves and changes frames by mouse, keyboard and finger, sliders that work, and a page that shows its pictures without scripts too.

    tests/page_in_chromium.py [--shots FOLDER] [--chromium PROGRAM] PAGE.html...

Python 3 and Chromium are all it needs: it speaks the DevTools protocol over a pipe (--remote-debugging-pipe). With --shots it leaves
pictures of the whole page, at 390 and 1440 px, in the light and in the dark, and the page as PDF. Exit code 0: all is well."""

import argparse
import base64
import json
import os
import pathlib
import subprocess
import sys
import tempfile

WIDTHS = (390, 1440)
MOST_BYTES = 3_000_000


class Browser:
    """Chromium, asked by commands and heard by events."""

    def __init__(self, program, profile):
        (to_read, self.to), (self.back, back_write) = os.pipe(), os.pipe()

        def pipes():
            # Chromium reads from 3 and writes to 4; first out of each other's way.
            a, b = os.dup(to_read), os.dup(back_write)
            while min(a, b) < 5:
                a, b = os.dup(a), os.dup(b)
            os.dup2(a, 3)
            os.dup2(b, 4)

        flags = ["--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                 "--no-first-run", "--disable-component-update", "--disable-background-networking", f"--user-data-dir={profile}"]
        self.process = subprocess.Popen([program, *flags, "about:blank"], preexec_fn=pipes, close_fds=False,
                                        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(to_read)
        os.close(back_write)
        self.number, self.events, self.rest, self.session = 0, [], b"", None

    def message(self):
        while b"\0" not in self.rest:
            part = os.read(self.back, 1 << 20)
            if not part:
                raise RuntimeError("Chromium has gone")
            self.rest += part
        text, self.rest = self.rest.split(b"\0", 1)
        return json.loads(text)

    def ask(self, method, **parameters):
        self.number += 1
        command = {"id": self.number, "method": method, "params": parameters}
        if self.session:
            command["sessionId"] = self.session
        data = json.dumps(command).encode() + b"\0"
        while data:
            data = data[os.write(self.to, data):]
        while True:
            message = self.message()
            if message.get("id") == self.number:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]
            self.events.append(message)

    def wait(self, method):
        while not any(e.get("method") == method for e in self.events):
            self.events.append(self.message())

    def value(self, expression):
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def close(self):
        self.process.terminate()
        self.process.wait(timeout=20)


# What can be seen of the first slider: where it stands, what is cut off the picture on top, and the middle of the picture.
SLIDER = """(() => {
  const figure = document.querySelector('.compare');
  if (!figure) return null;
  for (let part = figure; part; part = part.parentElement) if (part.tagName === 'DETAILS') part.open = true;
  const stack = figure.querySelector('.stack'), range = figure.querySelector('input');
  stack.scrollIntoView({block: 'center', behavior: 'instant'});
  const box = stack.getBoundingClientRect(), rail = range.getBoundingClientRect();
  return {value: range.value, clip: getComputedStyle(figure.querySelector('.after')).clipPath,
          box: [box.left, box.top, box.width, box.height], rail: [rail.left, rail.top, rail.width, rail.height]};
})()"""


def drag(browser, start, end):
    """The mouse, pressed at `start`, moved to `end` and let go."""
    mouse = lambda kind, at, **more: browser.ask("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], button="left", **more)
    mouse("mousePressed", start, clickCount=1, buttons=1)
    for step in range(1, 6):
        at = [a + (b - a) * step / 5 for a, b in zip(start, end)]
        mouse("mouseMoved", at, buttons=1)
    mouse("mouseReleased", end, clickCount=1)


def pixels(browser, box):
    """What the screen shows there, as the bytes of a PNG."""
    clip = {"x": box[0], "y": box[1], "width": box[2], "height": box[3], "scale": 1}
    clip["y"] += browser.value("scrollY")
    return browser.ask("Page.captureScreenshot", format="png", clip=clip)["data"]


def check_slider(browser, problems, where):
    before = browser.value(SLIDER)
    if before is None:
        return False
    shown = pixels(browser, before["box"])
    left, top, width, height = before["box"]
    # On the picture ...
    drag(browser, (left + width / 2, top + height / 2), (left + width * 0.2, top + height / 2))
    after = browser.value(SLIDER)
    if not 15 <= float(after["value"]) <= 25 or after["clip"] == before["clip"]:
        problems.append(f"{where}: dragged on the picture to 20 %, the slider is at {after['value']}, {after['clip']}")
    if pixels(browser, after["box"]) == shown:
        problems.append(f"{where}: dragged, and the screen shows the same")
    # ... on the rail, of which the knob takes a little at both ends ...
    left, top, width, height = after["rail"]
    browser.ask("Input.dispatchMouseEvent", type="mousePressed", x=left + width * 0.8, y=top + height / 2, button="left", clickCount=1, buttons=1)
    browser.ask("Input.dispatchMouseEvent", type="mouseReleased", x=left + width * 0.8, y=top + height / 2, button="left", clickCount=1)
    clicked = browser.value(SLIDER)
    if not 75 <= float(clicked["value"]) <= 86 or clicked["clip"] == after["clip"]:
        problems.append(f"{where}: clicked at 80 % of the rail, it is at {clicked['value']}, {clicked['clip']}")
    # ... and by the keyboard, which the click has given to it.
    for kind in ("keyDown", "keyUp"):
        browser.ask("Input.dispatchKeyEvent", type=kind, key="ArrowLeft", code="ArrowLeft", windowsVirtualKeyCode=37)
    if float(browser.value(SLIDER)["value"]) != float(clicked["value"]) - 1:
        problems.append(f"{where}: the left arrow does not move it")
    browser.value("document.querySelector('.compare input').value = 50, "
                  "document.querySelector('.compare input').dispatchEvent(new Event('input')), scrollTo(0, 0), "
                  "document.querySelectorAll('details').forEach(part => part.open = false)")
    return True


# What can be seen of the viewer: where the stage and the picture lie, what is shown, and how far the picture is moved.
VIEWER = """(() => {
  const stage = document.querySelector('.stage');
  const box = (part) => { const r = part.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; };
  return {stage: box(stage), canvas: box(stage.querySelector('.canvas')), moved: [stage.scrollLeft, stage.scrollTop],
          shown: document.querySelector('input[name=shown]:checked').value, said: document.querySelector('[role=status]').textContent,
          zoom: document.querySelector('input[name=zoom]:checked').value,
          layers: [...stage.querySelectorAll('.frame')].filter(i => !i.hidden).length, width: +document.querySelector('.viewer').dataset.width};
})()"""


def press(browser, letter):
    for kind in ("keyDown", "keyUp"):
        browser.ask("Input.dispatchKeyEvent", type=kind, key=letter, text=letter if kind == "keyDown" else "")


def settled(browser):
    """The viewer, after the pictures asked for are decoded and shown."""
    browser.value("Promise.all([...document.querySelectorAll('.stage img')].map(i => i.decode().catch(() => 0)))"
                  ".then(() => new Promise(done => setTimeout(done, 100)))")
    return browser.value(VIEWER)


def check_viewer(browser, problems, where):
    if not browser.value("!!document.querySelector('.viewer')"):
        problems.append(f"{where}: no viewer")
        return
    wrong = lambda words, state: problems.append(f"{where}: viewer: {words}: {state}")
    browser.value("document.querySelector('.stage').scrollIntoView({block: 'center', behavior: 'instant'})")
    fit = settled(browser)
    left, top, width, height = fit["stage"]
    if fit["canvas"][2] > width + 1 or fit["canvas"][3] > height + 1:
        wrong("does not fit", fit)
    shown = pixels(browser, fit["stage"])
    # The zooms, at the pixels of the screen.
    for zoom in (1, 2):
        browser.value(f"document.querySelectorAll('input[name=zoom]')[{zoom}].click()")
        state = settled(browser)
        if abs(state["canvas"][2] - zoom * state["width"]) > 1 or f"{100 * zoom} %" not in state["said"]:
            wrong(f"{100 * zoom} % is not that", state)
    browser.value("document.querySelector('.stage').scrollIntoView({block: 'center', behavior: 'instant'})")
    before = settled(browser)
    left, top, width, height = before["stage"]
    middle = (left + width / 2, top + height / 2)
    drag(browser, middle, (middle[0] - 40, middle[1] - 30))
    after = settled(browser)
    # What is smaller than the stage stays where it is.
    expected = [by if before["canvas"][2 + i] > before["stage"][2 + i] else 0 for i, by in enumerate((40, 30))]
    if [b - a for a, b in zip(before["moved"], after["moved"])] != expected or after["zoom"] != "2":
        wrong("dragged by 40 and 30", (before, after))
    # Another frame, at the same place and zoom; the mouse has given the keyboard to the stage.
    press(browser, "n")
    other = settled(browser)
    if other["shown"] == after["shown"] or other["moved"] != after["moved"] or other["canvas"] != after["canvas"] or other["layers"] != 1:
        wrong("N does not show a frame at the same place", (after, other))
    press(browser, "r")
    back = settled(browser)
    has_result = browser.value("!!document.querySelector('input[value=result]')")
    if has_result and (back["shown"] != "result" or back["layers"] != 0):
        wrong("R does not show the result", back)
    press(browser, "f")
    again = settled(browser)
    if again["zoom"] != "0" or again["canvas"][2:] != fit["canvas"][2:]:
        wrong("F does not fit", (fit, again))
    # A click goes there, and back.
    left, top, width, height = again["stage"]
    for expected in (True, False):
        spot = (left + width / 2, top + height / 2)
        for kind in ("mousePressed", "mouseReleased"):
            browser.ask("Input.dispatchMouseEvent", type=kind, x=spot[0], y=spot[1], button="left", clickCount=1)
        state = settled(browser)
        if (state["zoom"] != "0") != expected:
            wrong("clicked", state)
    # A finger moves what is larger than the stage.
    browser.value("document.querySelectorAll('input[name=zoom]')[2].click()")
    browser.value("document.querySelector('.stage').scrollIntoView({block: 'center', behavior: 'instant'})")
    before = settled(browser)
    left, top, width, height = before["stage"]
    browser.ask("Emulation.setTouchEmulationEnabled", enabled=True)
    finger = lambda kind, *points: browser.ask("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y} for x, y in points])
    finger("touchStart", (left + width / 2, top + height / 2))
    for step in range(1, 11):
        finger("touchMove", (left + width / 2 - 10 * step, top + height / 2))
    finger("touchEnd")
    browser.ask("Emulation.setTouchEmulationEnabled", enabled=False)
    after = settled(browser)
    # The first pixels tell a drag from a tap; what it moves on after the finger is gone is the browser's.
    if before["canvas"][2] > before["stage"][2] and after["moved"][0] - before["moved"][0] < 50 or after["zoom"] != "2":
        wrong("a finger does not move it", (before, after))
    browser.value("document.querySelectorAll('input[name=zoom]')[0].click()")
    # Every overlay changes what is seen.
    for name in browser.value("[...document.querySelectorAll('.switch input')].map(i => i.name)"):
        browser.value("document.querySelector('.stage').scrollIntoView({block: 'center', behavior: 'instant'})")
        clear = pixels(browser, settled(browser)["stage"])
        browser.value(f"document.querySelector('.switch input[name={name}]').click()")
        if pixels(browser, settled(browser)["stage"]) == clear:
            wrong(f"the overlay {name} shows nothing", "")
        browser.value(f"document.querySelector('.switch input[name={name}]').click()")
    browser.value("scrollTo(0, 0)")
    if not shown:
        wrong("shows nothing", "")


# Texts whose contrast with what lies behind them is under 4.5 (WCAG 2, relative luminance); those over pictures are left out.
CONTRAST = """(() => {
  const parse = (text) => text.match(/[\\d.]+/g).map(Number);
  const luminance = (c) => { const [r, g, b] = c.map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
                             return 0.2126 * r + 0.7152 * g + 0.0722 * b; };
  const behind = (part) => { for (; part; part = part.parentElement) { const c = parse(getComputedStyle(part).backgroundColor);
                             if (c.length < 4 || c[3] === 1) return c.slice(0, 3); } return [255, 255, 255]; };
  const low = new Set();
  for (const d of document.querySelectorAll('details')) d.open = true;
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const part = walk.currentNode.parentElement;
    if (!walk.currentNode.data.trim() || part.closest('script, style, title, .tag, .pills legend')) continue;
    const style = getComputedStyle(part), colour = part.closest('svg') ? style.fill : style.color;
    const [a, b] = [luminance(parse(colour).slice(0, 3)), luminance(behind(part))].sort((x, y) => y - x);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < 4.5) low.add(part.tagName + '.' + part.className.baseVal + part.className + ' ' + ratio.toFixed(2));
  }
  for (const d of document.querySelectorAll('details')) d.open = false;
  return [...low];
})()"""


def check_without_scripts(browser, address, problems, where):
    """The result, every frame and the overlays can be seen without scripts."""
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    browser.events.clear()
    browser.ask("Page.navigate", url=address)
    browser.wait("Page.loadEventFired")
    browser.ask("Emulation.setScriptExecutionDisabled", value=False)
    seen = browser.value("[...document.querySelectorAll('.card img, .stage img:not(.over)')].filter(i => i.clientWidth < 60).length + "
                         "[...document.querySelectorAll('.tools, .places')].filter(i => !i.hidden).length")
    if seen:
        problems.append(f"{where}: without scripts {seen} pictures are not seen, or tools that do nothing are")
    for name in browser.value("[...document.querySelectorAll('.switch input')].map(i => i.name)"):
        browser.value(f"document.querySelector('.switch input[name={name}]').checked = true")
        if not browser.value(f"document.querySelector('.over.{name}').clientWidth"):
            problems.append(f"{where}: without scripts the overlay {name} cannot be switched on")


def check_events(browser, address, problems, where):
    for event in browser.events:
        method, parameters = event.get("method"), event.get("params", {})
        if method == "Network.requestWillBeSent":
            asked = parameters["request"]["url"]
            if asked != address and not asked.startswith("data:"):
                problems.append(f"{where}: asks for {asked[:200]}")
        elif method == "Runtime.exceptionThrown":
            problems.append(f"{where}: {parameters['exceptionDetails'].get('exception', {}).get('description', 'an exception')}")
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in ("error", "warning", "assert"):
            problems.append(f"{where}: console: {parameters['args']}")
        elif method == "Log.entryAdded" and parameters["entry"]["level"] in ("error", "warning"):
            problems.append(f"{where}: log: {parameters['entry']['text']}")


def check(browser, page, shots, problems):
    address = page.resolve().as_uri()
    size = page.stat().st_size
    if size > MOST_BYTES:
        problems.append(f"{page}: {size} bytes")
    sliders = False
    for width in WIDTHS:
        for scheme in ("light", "dark"):
            where = f"{page.name} at {width} px, {scheme}"
            browser.events.clear()
            browser.ask("Emulation.setDeviceMetricsOverride", width=width, height=844 if width < 500 else 1000, deviceScaleFactor=1, mobile=width < 500)
            browser.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
            browser.ask("Page.navigate", url=address)
            browser.wait("Page.loadEventFired")
            broken = browser.value("Promise.all([...document.images].map(i => i.decode().then(() => null, () => i.alt)))"
                                   ".then(all => all.filter(Boolean))")
            problems.extend(f"{where}: a picture does not decode: {alt}" for alt in broken)
            silent = browser.value("[...document.images].filter(i => !i.alt).length + [...document.querySelectorAll('svg')]"
                                   ".filter(s => !s.getAttribute('aria-label')).length")
            if silent:
                problems.append(f"{where}: {silent} pictures have no words")
            wide = browser.value("document.documentElement.scrollWidth")
            if wide > width:
                problems.append(f"{where}: the page is {wide} px wide")
            paper = browser.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).slice(0, 3).map(Number)")
            if (sum(paper) < 384) != (scheme == "dark"):
                problems.append(f"{where}: the paper is {paper}")
            problems.extend(f"{where}: contrast: {low}" for low in browser.value(CONTRAST))
            check_viewer(browser, problems, where)
            sliders = check_slider(browser, problems, where) or sliders
            check_events(browser, address, problems, where)
            check_without_scripts(browser, address, problems, where)
            if shots:
                whole = browser.ask("Page.captureScreenshot", format="png", captureBeyondViewport=True)
                (shots / f"{page.stem}-{width}-{scheme}.png").write_bytes(base64.b64decode(whole["data"]))
    if shots:
        paper = browser.ask("Page.printToPDF", printBackground=False, paperWidth=8.27, paperHeight=11.69)
        (shots / f"{page.stem}.pdf").write_bytes(base64.b64decode(paper["data"]))
    print(f"{page}: {size} bytes, {'sliders work' if sliders else 'no slider'}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="+", type=pathlib.Path, metavar="PAGE.html")
    parser.add_argument("--shots", type=pathlib.Path, metavar="FOLDER", help="leave screenshots there")
    parser.add_argument("--chromium", default="chromium", metavar="PROGRAM")
    arguments = parser.parse_args()
    if arguments.shots:
        arguments.shots.mkdir(parents=True, exist_ok=True)
    problems = []
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(arguments.chromium, profile)
        try:
            target = browser.ask("Target.createTarget", url="about:blank")["targetId"]
            browser.session = browser.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Network", "Log"):
                browser.ask(f"{domain}.enable")
            for page in arguments.pages:
                check(browser, page, arguments.shots, problems)
        finally:
            browser.close()
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
