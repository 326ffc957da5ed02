// The page's address determines what is shown; events say when runs have changed.

import * as api from "./api.js";
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
  if (state.view) state.view.show(list);
  else route();
}

/** Routes to another address, and moves the focus to what it shows. */
function navigate() {
  // The first list is not there yet; it is routed when it arrives.
  if (!state.view) return;
  route();
  const heading = place.querySelector("h1");
  heading.tabIndex = -1;
  heading.focus();
}

function complain(trouble) {
  const line = document.getElementById("connection");
  line.hidden = trouble === "";
  line.textContent = trouble;
}

const dark = matchMedia("(prefers-color-scheme: dark)");

/** Reads the theme that was chosen here, and keeps another one if it is given. Browsers may refuse both. */
function chosenTheme(other) {
  try {
    if (other) localStorage.setItem("theme", other);
    return localStorage.getItem("theme");
  } catch {
    return other;
  }
}

/** Shows the theme that was chosen here, or else the system's. */
function showTheme(chosen = chosenTheme()) {
  document.documentElement.dataset.theme = chosen ?? (dark.matches ? "dark" : "light");
}

showTheme();
dark.addEventListener("change", () => showTheme());
document.getElementById("theme").addEventListener("click", () => {
  showTheme(chosenTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));
});
addEventListener("hashchange", navigate);
addEventListener("keydown", (event) => {
  const filter = document.getElementById("filter");
  if (event.key !== "/" || !filter || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.target.matches("input, select, textarea")) return;
  event.preventDefault();
  filter.focus();
});
api.listen(receive, complain);
