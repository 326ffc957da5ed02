"""Drives Chromium over a live page, for `page_browser.rs`, and checks what people see and do there.

The part `live` needs a live run called run and six others, `cloning` a live run of behavioral cloning called
run. The part `finished` needs finished runs called navigation, fetch-pick, fetch-push and ant-reach, one
called damaged, and one called untold, whose task does not tell success. It prints what it measures.
"""

import argparse
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import TypeVar

from PIL import Image
from selenium.common.exceptions import StaleElementReferenceException
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
# A run that is requested and does not exist.
UNKNOWN = "nobody"
WIDE, PHONE = (1300, 1150), (400, 800)
# Tabs of one page: more than the six connections that browsers open to a server.
TABS = 8


class Browser:
    """A browser that shows the page."""

    def __init__(self, driver: Chrome, address: str, pictures: Path | None) -> None:
        self.driver, self.address, self.pictures = driver, address, pictures
        self.driver.set_window_size(*WIDE)

    def open(self, place: str) -> None:
        """Opens a route of the page, as if the address had been typed."""
        self.driver.get("about:blank")
        self.driver.get(f"{self.address}#/{place}")

    def find(self, selector: str) -> WebElement:
        """Waits for a visible element and returns it."""
        seen = lambda: next((e for e in self.all(selector) if e.is_displayed()), None)
        return self.expect(f"element {selector}", seen)

    def all(self, selector: str) -> list[WebElement]:
        """Returns all current elements."""
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def texts(self, selector: str) -> list[str]:
        """Returns the current texts of all elements."""
        script = "return [...document.querySelectorAll(arguments[0])].map((e) => e.innerText);"
        return self.script(script, selector)

    def says(self, selector: str, words: str) -> None:
        """Waits until the text of an element contains `words`."""
        self.expect(f"{selector} to say {words}", lambda: any(words in text for text in self.texts(selector)))

    def press(self, label: str) -> None:
        """Presses the button with this label."""

        def pressed() -> bool:
            for button in self.all("button"):
                if button.text == label:
                    button.click()
                    return True
            return False

        self.expect(f"button {label}", pressed)

    def expect(self, what: str, look: Callable[[], Found]) -> Found:
        """Waits until `look` returns something true, and returns it."""
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            # An element that was redrawn during the check is checked again.
            with suppress(StaleElementReferenceException):
                if found := look():
                    return found
            time.sleep(0.02)
        message = f"expected {what} at {self.driver.current_url}, found: {self.texts('body')[0][:2000]}"
        raise AssertionError(message)

    def script(self, text: str, *arguments: object) -> object:
        """Runs JavaScript in the page."""
        return self.driver.execute_script(text, *arguments)

    def picture(self, name: str) -> None:
        """Saves a screenshot, if screenshots are wanted."""
        if self.pictures:
            self.driver.save_screenshot(self.pictures / f"{name}.png")


@contextmanager
def browser(address: str, pictures: Path | None) -> Iterator[Browser]:
    """Opens a browser and closes it at the end; errors in the page's console are failures."""
    options = ChromeOptions()
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = Chrome(options=options, service=Service("/usr/bin/chromedriver"))
    try:
        yield Browser(driver, address, pictures)
        severe = [line["message"] for line in driver.get_log("browser") if line["level"] == "SEVERE"]
        errors = [message for message in severe if f"/{UNKNOWN}" not in message]
        assert not errors, errors
    finally:
        driver.quit()


def runs_are_listed(page: Browser) -> None:
    """The list shows all runs and marks the live one; the first paint is fast and the page small."""
    page.open("")
    page.expect("seven runs", lambda: len(page.all("tbody tr")) == 7)
    page.says("tbody", "training")
    loaded = page.script("""
        const kinds = ["navigation", "resource"];
        const all = kinds.flatMap((kind) => performance.getEntriesByType(kind));
        return all.reduce((sum, entry) => sum + entry.encodedBodySize, 0);
    """)
    paint = "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime;"
    painted = page.expect("a first paint", lambda: page.script(paint))
    print(f"first paint after {painted:.0f} ms, {loaded / 1000:.0f} kB")
    # This is beside a run that trains, with software rendering; without them, it takes a fraction of that.
    assert painted < 5000 and loaded < 1_000_000
    page.picture("runs")
    filter_place = page.find("#filter")
    page.find("body").send_keys("/")
    assert page.driver.switch_to.active_element == filter_place
    filter_place.send_keys("ant-reach")
    page.expect("one run", lambda: len(page.all("tbody tr")) == 1)
    page.find("tbody a").click()
    heading = page.expect("another heading", lambda: (found := page.find("h1")).text != "Runs" and found)
    assert page.driver.switch_to.active_element == heading


def curves_move_while_a_run_trains(page: Browser) -> None:
    """The chart of a live run updates by itself."""
    page.open("run/run")
    drawn = lambda: page.script("return document.querySelector('svg.chart > path')?.getAttribute('d');")
    first = page.expect("a curve", drawn)
    page.expect("a curve that moves", lambda: drawn() != first)
    page.picture("run")


def the_keyboard_stays_where_it_is(page: Browser) -> None:
    """While a run trains, a checkbox and a column head keep the focus, and open details stay open."""
    page.open("")
    box = "input[aria-label='Compare run']"
    page.find(box)
    page.script("document.querySelector(arguments[0]).focus();", box)
    row = "return document.querySelector(arguments[0]).closest('tr').innerText;"
    first = page.script(row, box)
    page.expect("a line that changes", lambda: page.script(row, box) != first)
    assert page.script("return document.activeElement.getAttribute('aria-label');") == "Compare run"
    page.press("steps")
    assert page.script("return document.activeElement.textContent;") == "steps"
    assert len(page.all("th[aria-sort]")) == 1 and "" not in page.texts("th button")
    page.open("run/run")
    page.find("details > summary").click()
    told = lambda: page.texts(".facts dd")
    first = told()
    page.expect("facts that change", lambda: told() != first)
    assert page.script("return document.querySelector('details').open;")


def the_authors_curve_is_marked(page: Browser) -> None:
    """The chart of success has the rate that the authors published, and the facts say what it is."""
    page.open("run/run")
    mark = lambda: page.script("return document.querySelector('svg.chart .mark title')?.textContent;")
    assert "98" in page.expect("a mark", mark)
    page.says(".facts", "98 %, the end of their curve after 4.9 million steps")
    assert "MuJoCo" not in page.texts("body")[0], "NAVIGATION is a grid"


def cloning_moves_over_its_iterations(page: Browser) -> None:
    """The charts of a method without environment steps have iterations, and update by themselves, too."""
    page.open("run/run")
    page.expect("an axis of iterations", lambda: "iterations" in page.texts(".controls button"))
    chart = page.find("svg.chart[aria-label^='Policy loss']")
    page.expect(
        "a loss on held-out demonstrations", lambda: "held out loss" in chart.get_attribute("aria-label")
    )
    drawn = lambda: chart.get_attribute("innerHTML")
    first = drawn()
    page.expect("a curve that moves", lambda: drawn() != first)
    page.press("seconds")
    assert page.texts(".controls button[aria-pressed=true]") == ["seconds"]


def a_tab_that_is_not_seen_takes_no_connection(page: Browser) -> None:
    """Every one of many tabs shows the runs, and the first is up to date once it is seen again."""
    page.open("")
    first = page.driver.current_window_handle
    for _ in range(TABS):
        page.driver.switch_to.new_window("tab")
        page.open("")
        page.find("tbody tr")
    page.driver.switch_to.window(first)
    listed = page.texts("tbody")
    page.expect("a list that changes", lambda: page.texts("tbody") != listed)
    assert page.script("return document.getElementById('connection').hidden;")
    for tab in set(page.driver.window_handles) - {first}:
        page.driver.switch_to.window(tab)
        page.driver.close()
    page.driver.switch_to.window(first)


def a_stopped_and_a_killed_learner_show(page: Browser) -> None:
    """The table of processes shows that the learner is stopped; once it is killed, there is another one."""
    page.open("run/run")
    learner = lambda: next((row.split() for row in page.texts("tr") if row.startswith("learner")), None)
    _, process, *_ = page.expect("a learner", learner)
    os.kill(int(process), signal.SIGSTOP)
    page.says("body", "learner is stopped")
    os.kill(int(process), signal.SIGKILL)
    page.expect("another learner", lambda: (row := learner()) and row[1] != process and row[2] == "running")


def an_episode_plays_and_seeks(page: Browser, run: str) -> None:
    """The first episode plays, pauses, and shows any requested step."""
    page.open(f"episodes/{run}")
    step = lambda: int(page.find(".player input[type=range]").get_property("value"))
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
    page.says(".player", "step 3 of")
    assert before > 4 and colors(page.find(".stage")) > 4
    page.find("body").send_keys(Keys.ARROW_RIGHT)
    assert step() == 4
    print(f"{run}: a step is shown after {took:.1f} ms")
    assert took < 100


def pause(page: Browser) -> bool:
    """Pauses an episode that is playing; returns whether it stands still."""
    if "Pause" in page.texts(".player button"):
        page.press("Pause")
    return "Play" in page.texts(".player button")


def colors(stage: WebElement) -> int:
    """Counts the colors of a stage."""
    picture = Image.open(BytesIO(stage.screenshot_as_png)).convert("RGB")
    return len(picture.getcolors(picture.width * picture.height) or [])


def episodes_are_filtered_and_sorted(page: Browser) -> None:
    """The filter keeps the matching rows, and a click on a column head sorts by it."""
    page.open("episodes/navigation")
    page.expect("rows", lambda: len(page.all(".long tbody tr")) > 5)
    page.find("#filter").send_keys("failed, training, steps>1")
    cells = lambda number: page.texts(f".long tbody td:nth-child({number})")
    page.expect("failures alone", lambda: (found := cells(6)) and all("after" not in text for text in found))
    assert set(cells(2)) == {"training"}
    page.find("#filter").send_keys(Keys.CONTROL, "a", Keys.BACKSPACE)
    page.press("steps")
    longest = [int(text) for text in cells(7)]
    page.press("steps ▼" if "steps ▼" in page.texts("th button") else "steps")
    shortest = [int(text) for text in cells(7)]
    assert longest == sorted(longest, reverse=True) and shortest == sorted(shortest)
    assert shortest[0] < longest[0]
    page.press("Side by side")
    page.expect("two players", lambda: len(page.all(".player")) == 2)
    address = page.driver.current_url
    page.open(address.partition("#/")[2])
    page.expect("the two of the address", lambda: len(page.all(".player")) == 2)


def success_that_is_not_told_is_not_claimed(page: Browser) -> None:
    """No episode is shown or filtered as one that reached or missed the goal."""
    page.open("episodes/untold")
    page.says(".player", "iteration")
    assert not any(word in page.texts(".player")[0] for word in ["reached", "missed"])
    endings = page.texts(".long tbody td:nth-child(6)")
    assert len(endings) > 5 and set(endings) <= {"before the horizon", "at the horizon"}, endings
    for word in ["failed", "successful"]:
        page.find("#filter").send_keys(Keys.CONTROL, "a", Keys.BACKSPACE)
        page.find("#filter").send_keys(word)
        page.expect(
            "no episode", lambda: any(text.startswith("0 of ") for text in page.texts(".controls span.soft"))
        )
        page.says("main > p", "No episode matches the filter.")


def proximity_over_the_grid_is_drawn(page: Browser) -> None:
    """Choosing a checkpoint colors the free cells."""
    page.open("episodes/navigation")
    choice = page.find("select[aria-label='Proximity over the grid']")
    plain = colors(page.find(".stage canvas"))
    choice.send_keys(Keys.END)
    page.says(".grid", "dark")
    assert colors(page.find(".stage canvas")) > plain
    page.picture("proximity")
    # What was asked about the previous episode is given up, and not drawn over the next one.
    page.script("""
        const ask = window.fetch;
        window.held = [];
        window.fetch = async (address, ...rest) => {
            if (!address.includes("/grid")) return ask(address, ...rest);
            await new Promise((go) => window.held.push(go));
            return ask(address, ...rest).catch((error) => {
                window.isGivenUp = error.name === "AbortError";
                throw error;
            });
        };
    """)
    held = lambda: page.script("return window.held.length;")
    page.find(".long table").send_keys(Keys.ARROW_DOWN)
    page.expect("a question", lambda: held() == 1)
    page.find(".long table").send_keys(Keys.ARROW_DOWN)
    page.expect("another question", lambda: held() == 2)
    page.script("window.held[0]();")
    page.expect("a question given up", lambda: page.script("return window.isGivenUp;"))
    assert page.texts(".grid p") == [""]
    page.script("window.held[1]();")
    page.says(".grid", "dark")


def demonstrations_are_browsed(page: Browser) -> None:
    """The demonstrations can be browsed like the log."""
    page.open("episodes/fetch-pick/demonstrations")
    page.says(".long tbody", "demonstration")
    page.says(".player", "demonstrations, row")


def damage_is_told(page: Browser) -> None:
    """A log without its end shows what is left, and says so; unknown routes and refused words are handled."""
    page.open("episodes/damaged")
    page.says(".trouble", "cut off")
    assert len(page.all(".long tbody tr")) > 5
    page.open(f"episodes/{UNKNOWN}")
    page.says(".trouble", f"no run is called {UNKNOWN}")
    refused = page.script(
        """
        const api = await import(new URL("./api.js", document.baseURI).href);
        return api.episode([arguments[0], "log", "x"]).catch((error) => error.message);
        """,
        UNKNOWN,
    )
    assert "Invalid URL" in refused, refused
    page.open("run/50%")
    page.says("h1", "Runs")


def a_phone_and_the_dark_are_enough(page: Browser) -> None:
    """Nothing is wider than a phone's screen; the button switches between dark and light colors."""
    page.driver.set_window_size(*PHONE)
    for place in ["", "run/navigation", "episodes/navigation"]:
        page.open(place)
        page.expect("what is there", lambda: page.all("tbody a, svg.chart path, .stage canvas"))
        beyond = page.script("return document.scrollingElement.scrollWidth - innerWidth;")
        assert beyond <= 0, f"{place}: {beyond} pixels beyond a phone's width"
    page.picture("phone")
    ground = lambda: page.script("return getComputedStyle(document.body).backgroundColor;")
    light = ground()
    page.press("Dark or light")
    assert ground() != light
    page.driver.set_window_size(*WIDE)
    page.open("episodes/ant-reach")
    page.expect("an ant", lambda: colors(page.find(".stage")) > 100)
    page.picture("dark")


def main() -> None:
    """Runs the checks of one part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("address")
    parser.add_argument("part", choices=["live", "cloning", "finished"])
    parser.add_argument("--pictures", type=Path, help="folder for pictures of what is seen")
    options = parser.parse_args()
    with browser(options.address, options.pictures) as page:
        if options.part == "cloning":
            cloning_moves_over_its_iterations(page)
            return
        if options.part == "live":
            runs_are_listed(page)
            curves_move_while_a_run_trains(page)
            the_keyboard_stays_where_it_is(page)
            the_authors_curve_is_marked(page)
            a_tab_that_is_not_seen_takes_no_connection(page)
            a_stopped_and_a_killed_learner_show(page)
            return
        for run in ["navigation", "fetch-pick", "fetch-push", "ant-reach"]:
            an_episode_plays_and_seeks(page, run)
        episodes_are_filtered_and_sorted(page)
        success_that_is_not_told_is_not_claimed(page)
        proximity_over_the_grid_is_drawn(page)
        demonstrations_are_browsed(page)
        damage_is_told(page)
        a_phone_and_the_dark_are_enough(page)


if __name__ == "__main__":
    main()
