// Compares an episode's score with that under another reward.

import * as api from "./api.js";
import { button, element } from "./dom.js";

const EXAMPLES = ["reward.form=absolute", "reward.form=difference", "reward.uncertainty=0", "reward.uncertainty=0.1"];

/** Controls for another reward. `ontold` is called with the episode's score under it, or null when it is cleared. */
export class Otherwise {
  constructor(ontold, oncomplain) {
    Object.assign(this, { ontold, oncomplain, name: null, ticket: 0 });
    const known = element("datalist", { id: `rewards-${Math.random().toString(36).slice(2)}` },
      EXAMPLES.map((value) => element("option", { value })));
    this.settings = element("input", {
      type: "text", list: known.id, placeholder: "reward.form=absolute", "aria-label": "Another setting of the reward",
      onkeydown: (event) => { if (event.key === "Enter") this.ask(); },
    });
    this.model = element("select", { "aria-label": "Whose trained model", onchange: () => this.ask() });
    this.place = element("div", { class: "controls otherwise" },
      element("span", { class: "soft" }, "What if"), this.settings, known, this.model,
      button("Compare", () => this.ask()), button("Clear", () => this.clear()));
  }

  /** Takes another episode, until `signal` aborts. The models of other runs of its task can be selected. */
  take(name, task, runs, signal) {
    [this.name, this.signal] = [name, signal];
    const others = runs.filter((run) => run.task === task && run.id !== name[0]);
    const chosen = this.model.value;
    this.model.replaceChildren(element("option", { value: "" }, "this run's model"),
      ...others.map((run) => element("option", { value: run.id, selected: run.id === chosen }, `the model of ${run.id}`)));
    if (this.isAsked) this.ask();
  }

  /** Drops the response to what was asked before. */
  drop() {
    this.ticket += 1;
  }

  async ask() {
    this.drop();
    const { name, ticket } = this;
    this.isAsked = this.settings.value !== "" || this.model.value !== "";
    if (!this.isAsked) {
      this.ontold(null);
      return;
    }
    try {
      const told = await api.reward(name, this.settings.value, this.model.value, this.signal);
      if (this.ticket === ticket) this.ontold(told);
    } catch (error) {
      if (this.ticket === ticket) this.oncomplain(error.message);
    }
  }

  clear() {
    [this.settings.value, this.model.value] = ["", ""];
    this.ask();
  }
}
