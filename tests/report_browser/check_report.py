#!/usr/bin/env python3
"""Opens a report in headless Chromium, uses it as a reader would, and says what does not work.

    check_report.py report.html [--screenshots FOLDER]

Needs chromium and chromedriver (Debian: `apt-get install chromium chromium-driver`) and nothing but Python's own library: it speaks
WebDriver over HTTP. Exits with 0 if all holds, 1 if something does not, 77 if there is no browser.
"""

import argparse
import base64
import json
import os
import pathlib
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
RIGHT, LEFT = "\ue014", "\ue012"


class Browser:
    """A page in headless Chromium."""

    def __init__(self, driver, browser):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.address = f"http://127.0.0.1:{port}"
        self.driver = subprocess.Popen([driver, f"--port={port}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(100):
            try:
                self.call("GET", "/status")
                break
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.1)
        # Root may not have a sandbox, and a machine without a graphics card draws in software.
        switches = ["--headless=new", "--no-sandbox", "--window-size=1280,900", "--use-gl=angle", "--use-angle=swiftshader",
                    "--enable-unsafe-swiftshader", "--hide-scrollbars"]
        options = {"args": switches, "binary": browser}
        wanted = {"browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        opened = self.call("POST", "/session", {"capabilities": {"alwaysMatch": wanted}})
        self.session = f"/session/{opened['sessionId']}"

    def call(self, method, path, body=None):
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.address + path, data, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=60) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise RuntimeError(json.load(error)["value"]["message"]) from None

    def open(self, file):
        self.call("POST", f"{self.session}/url", {"url": pathlib.Path(file).resolve().as_uri()})

    def run(self, script, *arguments):
        return self.call("POST", f"{self.session}/execute/sync", {"script": script, "args": list(arguments)})

    def find(self, selector):
        return self.call("POST", f"{self.session}/element", {"using": "css selector", "value": selector})[ELEMENT]

    def press(self, selector, keys):
        self.call("POST", f"{self.session}/element/{self.find(selector)}/value", {"text": keys})

    def click(self, selector):
        # To the middle of the window, where neither contents nor controls lie over it.
        self.run("document.querySelector(arguments[0]).scrollIntoView({ block: 'center' })", selector)
        self.call("POST", f"{self.session}/element/{self.find(selector)}/click", {})

    def drag(self, selector, across, down):
        origin = {ELEMENT: self.find(selector)}
        moves = [{"type": "pointerMove", "duration": 0, "x": 0, "y": 0, "origin": origin}, {"type": "pointerDown", "button": 0},
                 {"type": "pointerMove", "duration": 100, "x": across, "y": down, "origin": origin}, {"type": "pointerUp", "button": 0}]
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": moves}
        self.call("POST", f"{self.session}/actions", {"actions": [mouse]})

    def size(self, width, height):
        self.call("POST", f"{self.session}/window/rect", {"width": width, "height": height})

    def screenshot(self, file):
        file.write_bytes(base64.b64decode(self.call("GET", f"{self.session}/screenshot")))

    def complaints(self):
        entries = self.call("POST", f"{self.session}/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] in ("SEVERE", "WARNING") and "GPU stall" not in entry["message"]
                and "swiftshader" not in entry["message"].lower()]

    def close(self):
        try:
            self.call("DELETE", self.session)
        finally:
            self.driver.terminate()
            self.driver.wait()


# Every fourth pixel of the 3D canvas: how many colours it has, which share is not background, and a sum that tells pictures apart.
PIXELS = """
const canvas = document.querySelector("#heart canvas");
const copy = document.createElement("canvas");
[copy.width, copy.height] = [canvas.width, canvas.height];
const context = copy.getContext("2d");
context.drawImage(canvas, 0, 0);
const bytes = context.getImageData(0, 0, copy.width, copy.height).data;
const colours = new Set();
let drawn = 0, sum = 0;
for (let n = 0; n < bytes.length; n += 16) {
  if (bytes[n + 3] > 0) { drawn++; colours.add((bytes[n] << 16) | (bytes[n + 1] << 8) | bytes[n + 2]); }
  sum = (sum * 31 + bytes[n] + 7 * bytes[n + 1] + 13 * bytes[n + 2]) % 2147483647;
}
return { colours: colours.size, share: drawn / (bytes.length / 16), sum };
"""
PATHS = "return [...document.querySelectorAll('#slices path')].map((path) => path.getAttribute('d')).join('|')"
CURSORS = "return [...document.querySelectorAll('line.cursor')].map((line) => line.getAttribute('x1')).join('|')"
INSTANT = "return document.getElementById('instant').textContent"
SLICES = """
return [...document.querySelectorAll("#slices canvas")].map((canvas) => {
  const bytes = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return new Set(bytes.filter((_, n) => n % 4 === 0)).size;
});
"""


class Checks:
    """What held and what did not."""

    def __init__(self):
        self.failures = 0

    def __call__(self, claim, holds, detail=""):
        self.failures += not holds
        print(f"{'ok    ' if holds else 'FAILED'}  {claim}{'' if holds else f': {detail}'}")


def check_page(page, check):
    check("the page has a heading, sections and a language", page.run(
        "return !!document.querySelector('h1').textContent && document.querySelectorAll('section').length >= 2 && document.documentElement.lang === 'en'"))
    foreign = page.run("return performance.getEntriesByType('resource').map((one) => one.name).filter((name) => !/^(data|blob):/.test(name))")
    check("nothing is fetched", not foreign, foreign)
    unnamed = page.run("""return [...document.querySelectorAll('svg[role=img], canvas, input, select, button')].filter((one) =>
        !(one.getAttribute('aria-label') || one.closest('label') || one.textContent.trim())).map((one) => one.outerHTML.slice(0, 80))""")
    check("every figure and control has a name", not unnamed, unnamed)
    wide = page.run("return document.documentElement.scrollWidth - document.documentElement.clientWidth")
    check("the page is not wider than the window", wide <= 0, f"by {wide} px")
    text = page.run("return document.body.innerText")
    check("no number is missing its value", not any(word in text for word in ("NaN", "undefined", "[object")), "NaN or undefined in the text")


def eventually(holds, limit_s=10):
    """Whether something comes to hold: a busy machine that draws in software answers late."""
    started = time.monotonic()
    while not holds():
        if time.monotonic() - started > limit_s:
            return False
        time.sleep(0.1)
    return True


def check_instant(page, check):
    """The slider, its keys and the play button."""
    before = page.run(CURSORS), page.run(INSTANT)
    page.press("#frame", RIGHT)
    check("an arrow key on the slider moves the instant and the marks of the charts",
          eventually(lambda: page.run(INSTANT) != before[1] and (page.run(CURSORS) != before[0] or not before[0])),
          (before, page.run(CURSORS), page.run(INSTANT)))
    moved = page.run(INSTANT)
    page.press("#frame", LEFT)
    check("the other arrow moves it back", eventually(lambda: page.run(INSTANT) == before[1] != moved))
    page.click("#play")
    # A beat is shown in its time: a busy machine that draws in software leaves frames out.
    seen, started = set(), time.monotonic()
    while len(seen) <= 2 and time.monotonic() - started < 60:
        seen.add(page.run(INSTANT))
        time.sleep(0.1)
    check("play shows frame after frame", len(seen) > 2, seen)
    page.click("#play")
    stopped = page.run(INSTANT)
    time.sleep(0.4)
    check("pause holds the frame", page.run(INSTANT) == stopped)
    page.run("const slider = document.getElementById('frame'); slider.value = 0; slider.dispatchEvent(new Event('input'))")


def check_slices(page, check):
    time.sleep(0.3)
    greys = page.run(SLICES)
    check("every slice shows an image", greys and min(greys) > 8, greys)
    if not page.run("return !!document.getElementById('frame')"):
        return
    before = page.run(PATHS)
    page.press("#frame", RIGHT * 3)
    check("the slider moves the contours", page.run(PATHS) != before and before)
    at = page.run(INSTANT)
    page.run("document.querySelector('#slices .views').focus()")
    page.press("#slices .views", LEFT)
    check("an arrow key on the slices moves the instant", page.run(INSTANT) != at)
    page.click("#slices .legend input")
    hidden = page.run(PATHS)
    page.click("#slices .legend input")
    check("a surface can be left out", hidden.count("M") < page.run(PATHS).count("M"))


def check_heart(page, check):
    page.run("document.getElementById('heart').scrollIntoView()")
    start = page.run(PIXELS)
    check("the mesh is drawn", start["colours"] > 40 and 0.03 < start["share"] < 0.95, start)
    page.drag("#heart canvas", 150, 40)
    turned = page.run(PIXELS)
    check("the mouse turns it", turned["sum"] != start["sum"], turned)
    page.press("#heart canvas", LEFT)
    check("an arrow key turns it", page.run(PIXELS)["sum"] != turned["sum"])
    before = page.run(PIXELS)
    page.press("#heart canvas", "-")
    check("minus goes away from it", page.run(PIXELS)["share"] < before["share"])
    fields = page.run("return document.querySelectorAll('#field option').length")
    pictures = []
    for place in range(fields):
        page.run("const field = document.getElementById('field'); field.value = arguments[0]; field.dispatchEvent(new Event('change'))", place)
        pictures.append(page.run(PIXELS)["sum"])
    check(f"each of the {fields} quantities colours it in its own way", len(set(pictures)) >= max(fields - 1, 1), pictures)
    if page.run("return !!document.getElementById('frame')"):
        before = page.run(PIXELS)["sum"]
        # A third of the beat on: a heart in diastole hardly moves.
        page.press("#frame", RIGHT * page.run("return Math.ceil(document.getElementById('frame').max / 3)"))
        check("the slider moves it", page.run(PIXELS)["sum"] != before)
    before = page.run(PIXELS)["sum"]
    page.click("#heart .parts input")
    check("a surface can be taken away", page.run(PIXELS)["sum"] != before)
    page.click("#heart .parts input")
    page.click("#heart .sides button")
    page.run("const field = document.getElementById('field'); field.value = 0; field.dispatchEvent(new Event('change'))")


def screenshots(page, folder):
    folder.mkdir(parents=True, exist_ok=True)
    page.run("window.scrollTo(0, 0)")
    page.screenshot(folder / "top.png")
    for number, _ in enumerate(page.run("return [...document.querySelectorAll('section')].map((one) => one.id)")):
        page.run("document.getElementById('s' + arguments[0]).scrollIntoView()", number)
        time.sleep(0.2)
        page.screenshot(folder / f"section_{number}.png")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("report", type=pathlib.Path)
    parser.add_argument("--screenshots", type=pathlib.Path)
    wanted = parser.parse_args()
    driver, browser = shutil.which("chromedriver"), os.environ.get("CHROMIUM") or shutil.which("chromium")
    if not (driver and browser):
        print("SKIPPED: no chromium with chromedriver; the report was not opened in a browser", file=sys.stderr)
        return 77
    check, page = Checks(), Browser(driver, browser)
    try:
        page.open(wanted.report)
        has = {name: page.run("return !!document.getElementById(arguments[0])", name) for name in ("slices", "heart", "frame")}
        check_page(page, check)
        if has["frame"]:
            check_instant(page, check)
        if has["slices"]:
            check_slices(page, check)
        if has["heart"]:
            check_heart(page, check)
        complaints = page.complaints()
        check("the browser has nothing to complain of", not complaints, complaints)
        if wanted.screenshots:
            screenshots(page, wanted.screenshots)
        shown = ", ".join(name for name, there in has.items() if there) or "text and charts only"
        print(f"{wanted.report}: {wanted.report.stat().st_size / 1e6:.2f} MB; {shown}; {check.failures} failed")
    finally:
        page.close()
    return 1 if check.failures else 0


if __name__ == "__main__":
    sys.exit(main())
