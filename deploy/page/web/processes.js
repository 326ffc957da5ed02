// The processes of a run while it is trained, and their output.

import * as api from "./api.js";
import { button, element, renew } from "./dom.js";

const LOOK_EVERY_MS = 2000;

/** The part of a run's view that shows its processes. */
export class Processes {
  constructor(id) {
    this.id = id;
    this.isLive = false;
    this.trouble = element("div", { role: "status" });
    [this.head, this.body, this.hosts] = [element("tr"), element("tbody"), element("div")];
    this.table = element("div", { hidden: true },
      element("h2", {}, "Processes"), this.trouble,
      element("div", { class: "scroll" }, element("table", { class: "processes" }, element("thead", {}, this.head), this.body)),
      this.hosts);
    this.output = element("div");
    this.place = element("div", {},
      this.table,
      element("h2", {}, "Output of the processes"),
      element("p", {}, button("Show", () => this.read())), this.output);
  }

  /** Shows the processes of a run while it is live. */
  follow(isLive) {
    if (isLive === this.isLive) return;
    this.isLive = isLive;
    clearTimeout(this.timer);
    if (isLive) this.look();
    else this.table.hidden = true;
  }

  async look() {
    // A hidden tab does not ask, as for the list of runs: another tab may need the connection.
    if (!document.hidden) await this.ask();
    if (!this.isLive) return;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.look(), LOOK_EVERY_MS);
  }

  async ask() {
    const failed = (error) => ({ trouble: error.message, head: [], rows: [], hosts: [] });
    const found = await api.processes(this.id).catch(failed);
    if (!this.isLive) return;
    this.table.hidden = !found;
    if (found) this.show(found);
  }

  show({ trouble, head, rows, hosts }) {
    renew(this.trouble, trouble ? [element("p", { class: "trouble" }, trouble)] : []);
    renew(this.head, head.map((name) => element("th", { class: "text", scope: "col" }, name)));
    renew(this.body, rows.map((row) => element("tr", {}, row.map((cell) => element("td", { class: "text" }, cell)))));
    renew(this.hosts, hosts.map((host) => element("p", { class: "soft" }, `Host ${host}`)));
  }

  async read() {
    const found = await api.output(this.id).catch((error) => [{ name: "trouble", text: error.message }]);
    const parts = found.map(({ name, text }) => element("details", { open: found.length === 1 },
      element("summary", {}, name), element("pre", {}, text)));
    this.output.replaceChildren(...(parts.length > 0 ? parts : [element("p", { class: "soft" }, "Nothing.")]));
  }

  close() {
    this.follow(false);
  }
}
