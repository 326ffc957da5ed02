// The page's address determines what is shown; events say when runs have changed.

import * as api from "./api.js";
import { element } from "./dom.js";
import { EpisodesView } from "./episodes.js";
import { ListView } from "./runs.js";
import { RunView } from "./run.js";

const state = { list: { folder: "", runs: [], trouble: [] }, view: null };
const place = document.getElementById("view");

/** Returns the kind of view and the names in the address; no kind and no names if the page has no such address. */
function asked() {
  const [, kind, rest] = location.hash.match(/^#\/(run|compare|episodes)\/(.+)$/) ?? [];
  try {
    return { kind, names: rest?.split(kind === "compare" ? "," : "/").map(decodeURIComponent) ?? [] };
  } catch {
    // The address has a `%` that is not part of an escape sequence, as in a name that was typed.
    return { names: [] };
  }
}

/** Shows the view of the address. */
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
  line.textContent = isThere ? "" : "The server does not answer. The page reconnects automatically.";
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
