// The address of the page says what is shown; events say when it has changed.

import * as api from "./api.js";
import { element } from "./dom.js";
import { EpisodesView } from "./episodes.js";
import { ListView } from "./runs.js";
import { RunView } from "./run.js";

const state = { list: { folder: "", runs: [], trouble: [] }, view: null };
const place = document.getElementById("view");

/** What the address asks for: a kind of view, and names; neither where it is no address of the page's. */
function asked() {
  const [, kind, rest] = location.hash.match(/^#\/(run|compare|episodes)\/(.+)$/) ?? [];
  try {
    return { kind, names: rest?.split(kind === "compare" ? "," : "/").map(decodeURIComponent) ?? [] };
  } catch {
    // A `%` that begins no byte, as in a name that somebody has typed.
    return { names: [] };
  }
}

/** Shows what the address asks for. */
function route() {
  state.view?.close();
  const { kind, names } = asked();
  state.view = {
    run: () => new RunView(place, names.slice(0, 1)),
    compare: () => new RunView(place, names),
    episodes: () => new EpisodesView(place, names),
  }[kind]?.() ?? new ListView(place);
  state.view.show(state.list);
  const name = kind === "compare" ? names.join(", ") : names[0];
  document.title = name ? `${name} - Goalward` : "Goalward";
}

function receive(list) {
  state.list = list;
  document.getElementById("folder").textContent = list.folder;
  state.view?.show(list);
}

function connected(isThere) {
  const line = document.getElementById("connection");
  line.hidden = isThere;
  line.textContent = isThere ? "" : "The server does not answer. The page connects again by itself.";
}

function chooseTheme(theme) {
  document.documentElement.dataset.theme = theme;
  localStorage.setItem("theme", theme);
}

const dark = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
chooseTheme(localStorage.getItem("theme") ?? dark);
document.getElementById("theme").addEventListener("click", () => {
  chooseTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
});
addEventListener("hashchange", route);
addEventListener("keydown", (event) => {
  const filter = document.getElementById("filter");
  if (event.key === "/" && filter && document.activeElement !== filter) {
    event.preventDefault();
    filter.focus();
  }
});

try {
  receive(await api.runs());
  route();
} catch (error) {
  place.replaceChildren(element("p", { class: "trouble" }, `The runs cannot be read: ${error.message}`));
}
api.listen(receive, connected);
