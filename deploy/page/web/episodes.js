// The episodes of a run: a table that can be sorted and filtered, and players for the selected ones.

import * as api from "./api.js";
import { button, element, renew } from "./dom.js";
import { count, short } from "./format.js";
import { Player } from "./player.js";
import { Rows } from "./rows.js";
import { LongTable } from "./table.js";
import { oneAtATime } from "./turns.js";

const COLUMNS = [
  { key: "place", label: "#" },
  { key: "source", label: "of", text: true },
  { key: "iteration", label: "iteration" },
  { key: "lane", label: "lane" },
  { key: "episode", label: "episode" },
  { key: "success", label: "success", text: true, show: ended },
  { key: "steps", label: "steps" },
  { key: "return", label: "return", show: (row) => short(row.return) },
  { key: "environment_return", label: "environment's return", show: (row) => short(row.environment_return) },
  { key: "proximity", label: "last proximity", show: (row) => short(row.proximity) },
  { key: "uncertainty", label: "uncertainty", show: (row) => short(row.uncertainty) },
];
const ENDINGS = ["at the goal", "at the horizon", "failed"];
// The same where the task does not tell success.
const UNTOLD_ENDINGS = ["before the horizon", "at the horizon", "before the horizon"];
// Buttons for common filters, each with its sort order.
const SHORTCUTS = [
  ["newest", "", { key: "place", falls: true }],
  ["failed", "failed", { key: "place", falls: true }],
  ["most uncertain", "", { key: "uncertainty", falls: true }],
  ["evaluation", "evaluation", { key: "place", falls: true }],
];

/** The view of a run's episodes, at an address of run, collection, row, and the row of a second episode, if any. */
export class EpisodesView {
  constructor(place, [run, collection = "log", row = "", beside = ""]) {
    Object.assign(this, { run, collection, isOpen: true, known: null, runs: [] });
    this.wanted = [row, beside].map((text) => (text === "" ? null : Number(text)));
    this.trouble = element("div", { role: "alert" });
    this.told = element("span", { class: "soft" });
    this.nothing = element("p", { role: "status" });
    this.filter = element("input", {
      id: "filter", type: "search", "aria-label": "Filter episodes", oninput: () => this.draw(),
      placeholder: "Filter ( / ): failed, evaluation, steps<20, uncertainty>0.1",
    });
    this.table = new LongTable(COLUMNS, SHORTCUTS[0][2], {
      onsort: () => this.draw(), onchoose: (chosen) => this.play(chosen),
    });
    this.collections = element("select", { "aria-label": "Collection", onchange: () => this.change(this.collections.value) });
    this.beside = button("Side by side", () => this.putBeside(), { "aria-pressed": "false", disabled: true });
    this.players = element("div", { class: "players" });
    place.replaceChildren(
      element("p", {}, element("a", { href: "#/" }, "All runs"), " / ",
        element("a", { href: `#/run/${encodeURIComponent(run)}` }, run)),
      element("h1", {}, "Episodes"), this.trouble, this.players,
      element("div", { class: "controls" }, this.collections, this.filter, SHORTCUTS.map((known) => this.shortcut(known)),
        this.beside, this.told),
      this.nothing, this.table.place,
    );
    this.first = new Player();
    this.second = null;
    this.players.replaceChildren(this.first.place);
    this.onkey = (event) => this.key(event);
    addEventListener("keydown", this.onkey);
    this.open(collection);
  }

  shortcut([label, filter, sorting]) {
    return button(label, () => {
      this.filter.value = filter;
      this.table.head.sort(sorting);
      this.draw();
    });
  }

  close() {
    this.isOpen = false;
    removeEventListener("keydown", this.onkey);
    this.first.close();
    this.second?.close();
  }

  /** Reads again if the run has changed according to the list. */
  async show(list) {
    this.runs = list.runs;
    this.line = api.standing(list, this.run);
    if (this.known !== this.line) await this.refresh();
  }

  /** Changes to another collection and plays its first row shown. */
  async change(collection) {
    [this.first.name, this.wanted] = [null, [null, null]];
    this.beside.disabled = true;
    this.table.forget();
    await this.open(collection);
  }

  async open(collection) {
    this.collection = collection;
    [this.rows, this.known] = [new Rows(this.run, collection), null];
    this.refresh = oneAtATime(() => this.read());
    this.told.textContent = "Reading the episodes…";
    [this.nothing.hidden, this.table.place.hidden] = [true, true];
    await this.refresh();
  }

  /** Reads new rows; returns false on failure. */
  async read() {
    const { rows, line } = this;
    const isLeft = () => !this.isOpen || rows !== this.rows;
    if (isLeft()) return true;
    try {
      const details = await api.details(this.run);
      if (isLeft()) return true;
      this.know(details);
      await rows.read();
    } catch (error) {
      if (!isLeft()) {
        this.told.textContent = "";
        this.tell([error.message]);
      }
      return false;
    }
    if (isLeft()) return true;
    this.known = line;
    this.tell(rows.trouble);
    this.draw();
    this.playWanted();
    return true;
  }

  /** Updates the run's collections and checkpoints. */
  know(details) {
    this.details = details;
    for (const player of [this.first, this.second]) player?.know(details);
    const [names, known] = [details.collections, Array.from(this.collections.options, ({ value }) => value)];
    if (String(names) !== String(known)) {
      this.collections.replaceChildren(...names.map((name) => element("option", { value: name }, name)));
    }
    this.collections.value = this.collection;
  }

  /** Plays the episodes named in the address, or the first row shown; does nothing if an episode is already open. */
  async playWanted() {
    const [row, beside] = this.wanted;
    const found = row === null ? this.shown[0] : this.rows.rows[row];
    if (this.first.name || !found) return;
    if (beside !== null && this.rows.rows[beside]) {
      await this.play(this.rows.rows[beside]);
      if (!this.isOpen) return;
      await this.putBeside();
    }
    if (this.isOpen) await this.play(found);
  }

  tell(lines) {
    renew(this.trouble, lines.map((line) => element("p", { class: "trouble" }, line)));
  }

  draw() {
    // The rows have not been read yet.
    if (this.known === null) return;
    this.shown = this.rows.chosen(this.filter.value, this.table.head.sorting);
    const [all, isEmpty] = [this.rows.rows.length, this.shown.length === 0];
    this.told.textContent = `${count(this.shown.length)} of ${count(all)} episodes`;
    this.nothing.textContent = all === 0 ? "No episodes yet." : "No episode matches the filter.";
    [this.nothing.hidden, this.table.place.hidden] = [!isEmpty, isEmpty];
    this.table.show(this.shown);
  }

  async play(row) {
    this.table.choose(row);
    this.beside.disabled = false;
    const opened = this.first.open([this.run, this.collection, row.place], this.details, this.runs);
    this.writeAddress();
    await opened;
  }

  /** Writes what is played into the address. A second episode of another collection is left out. */
  writeAddress() {
    const [, collection, row] = this.first.name;
    const [, other, beside] = this.second?.name ?? [];
    const parts = [this.run, collection, row, ...(other === collection ? [beside] : [])];
    history.replaceState(null, "", `${location.pathname}${location.search}#/episodes/${parts.map(encodeURIComponent).join("/")}`);
  }

  /** Opens a second player at the right with the current episode, or closes it. */
  async putBeside() {
    const isThere = this.second !== null;
    this.beside.setAttribute("aria-pressed", String(!isThere));
    if (isThere) {
      this.second.close();
      this.second = null;
    } else {
      this.second = new Player({ follows: true });
    }
    const opened = this.second?.open(this.first.name, this.details, this.runs);
    this.first.follower = this.second;
    this.writeAddress();
    this.players.replaceChildren(this.first.place, ...(this.second ? [this.second.place] : []));
    this.first.resize();
    await opened;
    this.first.seek(this.first.at);
  }

  key(event) {
    if (event.target.matches("input, select, textarea")) return;
    if (event.key === " " && !event.target.matches("button")) {
      event.preventDefault();
      this.first.toggle();
    }
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step && !event.target.matches("svg")) this.first.seek(this.first.at + step);
  }
}

function ended({ success, ending, steps_to_goal: reached }) {
  const endings = success === null ? UNTOLD_ENDINGS : ENDINGS;
  return element("span", { class: `state ${success ? "reached" : ""}` }, success ? `after ${reached}` : endings[ending]);
}
