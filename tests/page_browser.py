"""Drives Chromium over a live page, for `page_browser.rs`: what people see and do there.

It asks for runs called navigation, fetch-pick, fetch-push, ant-reach, damaged, and a live one called run. Figures
that it measures are printed.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TypeVar

from PIL import Image
from selenium.webdriver import Chrome, ChromeOptions
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

Found = TypeVar("Found")

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
PATIENCE_S = 120
WIDE, PHONE = (1300, 1150), (400, 800)


class Browser:
    """A browser with the page in it."""

    def __init__(self, driver: Chrome, address: str, pictures: Path | None) -> None:
        self.driver, self.address, self.pictures = driver, address, pictures
        self.driver.set_window_size(*WIDE)

    def open(self, place: str) -> None:
        """Goes to a place of the page, as if the address had been typed."""
        self.driver.get("about:blank")
        self.driver.get(f"{self.address}/#/{place}")

    def find(self, selector: str) -> WebElement:
        """Waits for an element that is seen."""
        return self.expect(f"element {selector}", lambda: next((e for e in self.all(selector) if e.is_displayed()), None))

    def all(self, selector: str) -> list[WebElement]:
        """All elements now."""
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def button(self, label: str) -> WebElement:
        """A button by its label."""
        found = lambda: next((e for e in self.all("button") if e.text == label), None)  # noqa: E731
        return self.expect(f"button {label}", found)

    def expect(self, what: str, look: Callable[[], Found]) -> Found:
        """Waits until `look` finds something."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if found := look():
                return found
            time.sleep(0.02)
        message = f"expected {what} at {self.driver.current_url}, found: {self.find('body').text[:2000]}"
        raise AssertionError(message)

    def script(self, text: str, *arguments: object) -> object:
        """Runs JavaScript in the page."""
        return self.driver.execute_script(text, *arguments)

    def picture(self, name: str) -> None:
        """Keeps a picture of what is seen, if pictures are wanted."""
        if self.pictures:
            self.driver.save_screenshot(self.pictures / f"{name}.png")


@contextmanager
def browser(address: str, pictures: Path | None) -> Iterator[Browser]:
    """A browser, closed at the end; errors that the page has told of in its console are failures."""
    options = ChromeOptions()
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    try:
        yield Browser(driver, address, pictures)
        errors = [line["message"] for line in driver.get_log("browser") if line["level"] == "SEVERE"]
        assert not errors, errors
    finally:
        driver.quit()


def runs_are_listed(page: Browser) -> None:
    """The list has all runs, the live one marked; first paint is quick and small."""
    page.open("")
    page.expect("six runs", lambda: len(page.all("tbody tr")) == 6)
    assert "live" in page.find("tbody").text
    loaded = page.script("""
        const all = [...performance.getEntriesByType("navigation"), ...performance.getEntriesByType("resource")];
        return all.reduce((sum, entry) => sum + entry.encodedBodySize, 0);
    """)
    painted = page.script("return performance.getEntriesByName('first-contentful-paint')[0].startTime;")
    print(f"first paint after {painted:.0f} ms, {loaded / 1000:.0f} kB")
    assert painted < 1000 and loaded < 1_000_000
    page.picture("runs")
    filter_place = page.find("#filter")
    page.find("body").send_keys("/")
    assert page.driver.switch_to.active_element == filter_place
    filter_place.send_keys("ant-reach")
    page.expect("one run", lambda: len(page.all("tbody tr")) == 1)


def curves_move_while_a_run_trains(page: Browser) -> None:
    """The chart of a live run goes on by itself."""
    page.open("run/run")
    drawn = lambda: page.find("svg.chart path").get_attribute("d")  # noqa: E731
    first = drawn()
    page.expect("a curve that moves", lambda: drawn() != first)
    page.picture("run")


def an_episode_plays_and_seeks(page: Browser, run: str) -> None:
    """The episode that is shown first moves, stops, and shows any step that is asked for."""
    page.open(f"episodes/{run}")
    step = lambda: int(page.find(".player input[type=range]").get_property("value"))  # noqa: E731
    page.expect("an episode that moves", lambda: step() > 2)
    page.expect("a stage with something on it", lambda: colors(page.find(".stage")) > 4)
    if run in ("navigation", "ant-reach"):
        page.picture(f"episode-{run}")
    page.expect("a pause", lambda: pause(page))
    before = colors(page.find(".stage"))
    took = page.script("""
        const timeline = document.querySelector(".player input[type=range]");
        const begun = performance.now();
        timeline.value = 3;
        timeline.dispatchEvent(new Event("input"));
        return performance.now() - begun;
    """)
    assert "step 3 of" in page.find(".player").text
    assert before > 4 and colors(page.find(".stage")) > 4
    page.find("body").send_keys(Keys.ARROW_RIGHT)
    assert step() == 4
    print(f"{run}: a step is shown after {took:.1f} ms")
    assert took < 100


def pause(page: Browser) -> bool:
    """Stops what is played, unless it has come to its end."""
    if page.find(".player .seen button:not([aria-label])").text == "Pause":
        page.button("Pause").click()
    return bool(page.button("Play"))


def colors(stage: WebElement) -> int:
    """How many colors a stage has."""
    picture = Image.open(BytesIO(stage.screenshot_as_png)).convert("RGB")
    return len(picture.getcolors(picture.width * picture.height) or [])


def episodes_are_filtered_and_sorted(page: Browser) -> None:
    """The filter leaves what it says, a click on a column sorts by it."""
    page.open("episodes/navigation")
    page.expect("rows", lambda: len(page.all(".long tbody tr")) > 5)
    page.find("#filter").send_keys("failed training")
    cells = lambda number: [row.text for row in page.all(f".long tbody td:nth-child({number})")]  # noqa: E731
    page.expect("failures alone", lambda: (found := cells(6)) and all("after" not in text for text in found))
    assert set(cells(2)) == {"training"}
    page.find("#filter").send_keys(Keys.CONTROL, "a", Keys.BACKSPACE)
    page.button("steps").click()
    steps = [int(text) for text in cells(7)]
    assert steps == sorted(steps) and steps[0] < steps[-1]
    page.button("Put beside").click()
    page.expect("two players", lambda: len(page.all(".player")) == 2)
    address = page.driver.current_url
    page.open(address.partition("#/")[2])
    page.expect("the two of the address", lambda: len(page.all(".player")) == 2)


def proximity_over_the_grid_is_drawn(page: Browser) -> None:
    """A checkpoint that is chosen colors the free cells."""
    page.open("episodes/navigation")
    choice = page.find("select[aria-label='Proximity over the grid']")
    plain = colors(page.find(".stage canvas"))
    choice.send_keys(Keys.END)
    page.expect("a legend", lambda: "dark" in page.find(".grid").text)
    assert colors(page.find(".stage canvas")) > plain
    page.picture("proximity")


def demonstrations_are_browsed(page: Browser) -> None:
    """Another collection is a choice away."""
    page.open("episodes/fetch-pick/demonstrations")
    page.expect("demonstrations", lambda: "demonstration" in page.find(".long tbody").text)
    page.expect("one of them", lambda: "demonstrations, row" in page.find(".player").text)


def damage_is_told(page: Browser) -> None:
    """A log that has lost its end shows what is left, and says so."""
    page.open("episodes/damaged")
    assert "cut off" in page.find(".trouble").text
    assert len(page.all(".long tbody tr")) > 5
    page.open("episodes/nobody")
    assert "no run is called nobody" in page.find(".trouble").text


def a_phone_and_the_dark_are_enough(page: Browser) -> None:
    """Nothing is wider than a phone; colors follow the choice."""
    page.driver.set_window_size(*PHONE)
    for place in ["", "run/navigation", "episodes/navigation"]:
        page.open(place)
        page.expect("a table or a chart", lambda: page.all("table") or page.all("svg.chart path"))
        beyond = page.script("return document.scrollingElement.scrollWidth - innerWidth;")
        assert beyond <= 0, f"{place}: {beyond} pixels beyond a phone's width"
    page.picture("phone")
    ground = lambda: page.script("return getComputedStyle(document.body).backgroundColor;")  # noqa: E731
    light = ground()
    page.button("Dark or light").click()
    assert ground() != light
    page.driver.set_window_size(*WIDE)
    page.open("episodes/ant-reach")
    page.expect("an ant", lambda: colors(page.find(".stage")) > 100)
    page.picture("dark")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("--pictures", type=Path, help="folder for pictures of what is seen")
    options = parser.parse_args()
    with browser(options.address, options.pictures) as page:
        runs_are_listed(page)
        curves_move_while_a_run_trains(page)
        for run in ["navigation", "fetch-pick", "fetch-push", "ant-reach"]:
            an_episode_plays_and_seeks(page, run)
        episodes_are_filtered_and_sorted(page)
        proximity_over_the_grid_is_drawn(page)
        demonstrations_are_browsed(page)
        damage_is_told(page)
        a_phone_and_the_dark_are_enough(page)


if __name__ == "__main__":
    main()
