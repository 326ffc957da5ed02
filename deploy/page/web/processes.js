// The processes of a run while it is trained, and their output.

import * as api from "./api.js";
import { button, element } from "./dom.js";

const LOOK_EVERY_MS = 2000;

/** The part of a run's view that shows its processes. */
export class Processes {
  constructor(id) {
    this.id = id;
    this.table = element("div");
    this.output = element("div");
    this.place = element("div", {},
      this.table,
      element("h2", {}, "Output of the processes"),
      element("p", {}, button("Show", () => this.read())), this.output);
    this.look();
  }

  async look() {
    try {
      this.show(await api.processes(this.id));
    } catch (error) {
      this.table.replaceChildren(element("p", { class: "trouble" }, error.message));
    }
    if (!this.isClosed) this.timer = setTimeout(() => this.look(), LOOK_EVERY_MS);
  }

  show(found) {
    if (!found) {
      this.table.replaceChildren();
      return;
    }
    const head = found.head.map((name) => element("th", { class: "text", scope: "col" }, name));
    const rows = found.rows.map((row) => element("tr", {}, row.map((cell) => element("td", { class: "text" }, cell))));
    this.table.replaceChildren(
      element("h2", {}, "Processes"),
      found.trouble ? element("p", { class: "trouble", role: "status" }, found.trouble) : "",
      element("div", { class: "scroll" }, element("table", { class: "processes" },
        element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows))),
      ...found.hosts.map((host) => element("p", { class: "soft" }, `Host ${host}`)));
  }

  async read() {
    const found = await api.output(this.id).catch((error) => [{ name: "trouble", text: error.message }]);
    const parts = found.map(({ name, text }) => element("details", { open: found.length === 1 },
      element("summary", {}, name), element("pre", {}, text)));
    this.output.replaceChildren(...(parts.length > 0 ? parts : [element("p", { class: "soft" }, "Nothing.")]));
  }

  close() {
    this.isClosed = true;
    clearTimeout(this.timer);
  }
}
