// The address of the page says what is shown; events say when it has changed.

import * as api from "./api.js";
import { element } from "./dom.js";
import { EpisodesView } from "./episodes.js";
import { ListView } from "./runs.js";
import { RunView } from "./run.js";

const state = { list: { folder: "", runs: [], trouble: [] }, view: null };
const place = document.getElementById("view");

/** Shows what the address asks for. */
function route() {
  state.view?.close();
  const [, kind, rest] = location.hash.match(/^#\/(run|compare|episodes)\/(.+)$/) ?? [];
  const ids = kind === "compare" ? rest.split(",").map(decodeURIComponent) : [];
  const parts = rest?.split("/").map(decodeURIComponent) ?? [];
  state.view = {
    run: () => new RunView(place, parts.slice(0, 1)),
    compare: () => new RunView(place, ids),
    episodes: () => new EpisodesView(place, parts),
  }[kind]?.() ?? new ListView(place);
  state.view.show(state.list);
  const name = kind === "compare" ? ids.join(", ") : parts[0];
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
