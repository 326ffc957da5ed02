// Plays an episode: what the agent does, a timeline, and the scores by the reward model.

import * as api from "./api.js";
import { Chart } from "./chart.js";
import { button, element } from "./dom.js";
import { short } from "./format.js";
import { GridStage } from "./grid.js";
import { NumberStage } from "./numbers.js";
import { Otherwise } from "./otherwise.js";
import { PictureStage } from "./pictures.js";
import { SolidStage } from "./solids.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];
// Steps per second at speed 1.
const PACE = { cells: 8, vector: 20 };
// Height of a chart beside the stage.
const HEIGHT = 125;
const COLORS = { proximity: "var(--c0)", uncertainty: "var(--c1)", reward: "var(--c2)" };

/** Plays one episode at a time. `follower` is another player that shows the same step and does not play by itself. */
export class Player {
  constructor({ follows = false } = {}) {
    [this.name, this.at, this.last, this.isPlaying, this.follower, this.follows] = [null, 0, 0, false, null, follows];
    this.caption = element("p", { class: "soft" });
    this.trouble = element("p", { class: "trouble", role: "alert", hidden: true });
    this.stagePlace = element("div", { class: "stage" });
    this.button = button("Play", () => this.toggle());
    this.timeline = element("input", {
      type: "range", min: 0, max: 0, value: 0, step: 1, "aria-label": "Step",
      oninput: () => this.seek(Number(this.timeline.value)),
    });
    this.speed = element("select", { "aria-label": "Speed" },
      SPEEDS.map((speed) => element("option", { value: speed, selected: speed === 1 }, `${speed} x`)));
    this.told = element("span", { class: "soft" });
    this.extras = element("div", { class: "controls" });
    this.charts = {
      proximity: new Chart({ title: "Proximity", height: HEIGHT }),
      uncertainty: new Chart({ title: "Uncertainty", height: HEIGHT }),
      reward: new Chart({ title: "Reward of each step", height: HEIGHT }),
    };
    this.otherwise = new Otherwise((told) => { this.other = told; this.complain(""); this.draw(); }, (line) => this.complain(line));
    for (const chart of Object.values(this.charts)) chart.onpoint = (step) => this.seek(Math.round(step));
    this.place = element("section", { class: "player", hidden: true },
      element("div", { class: "seen" }, this.stagePlace, this.extras,
        element("div", { class: "controls" }, ...(follows ? [] : [this.button, this.timeline, this.speed]), this.told),
        this.caption, this.trouble),
      element("div", { class: "curves" }, Object.values(this.charts).map((chart) => chart.figure), this.otherwise.place));
  }

  /** Opens an episode. `name` is its run, collection and row; `runs` are all runs. */
  async open(name, details, runs) {
    [this.name, this.details, this.runs] = [name, details, runs];
    this.clear();
    this.caption.textContent = "Reading the episode…";
    // What was asked for another episode no longer needs an answer, and would hold this one up.
    this.asking?.abort();
    this.asking = new AbortController();
    try {
      const episode = await api.episode(name, this.asking.signal);
      if (this.name === name) await this.take(episode);
    } catch (error) {
      if (this.name !== name) return;
      this.caption.textContent = "";
      this.complain(error.message);
    }
  }

  /** Leaves the episode. Its place stays, so that nothing below it moves. */
  clear() {
    this.stop();
    this.episode = null;
    this.otherwise.drop();
    this.complain("");
    this.place.hidden = false;
    this.place.classList.add("blank");
  }

  async take(episode) {
    const { name } = this;
    this.last = episode.steps;
    this.timeline.max = episode.steps;
    this.drawCurves(episode);
    this.otherwise.take(name, episode.task.name, this.runs, this.asking.signal);
    await this.stage(episode);
    if (this.name !== name) return;
    this.episode = episode;
    this.caption.textContent = caption(name, episode);
    this.place.classList.remove("blank");
    this.seek(0);
    if (!this.follows && !matchMedia("(prefers-reduced-motion: reduce)").matches) this.start();
  }

  /** Updates the details of the run, such as its checkpoints. */
  know(details) {
    const isSame = String(this.details?.checkpoints) === String(details.checkpoints);
    this.details = details;
    if (isSame || !(this.shown instanceof GridStage) || !this.episode) return;
    if (this.heated && !details.checkpoints.map(String).includes(String(this.heated))) this.drawHeat("");
    const menu = this.extras.querySelector("select");
    const [choice] = this.heat();
    // An open menu would close if it were replaced.
    if (!menu) this.extras.prepend(...(choice ? [choice] : []));
    else if (choice && document.activeElement !== menu) menu.replaceWith(choice);
  }

  /** Shows the stage that fits the task: a grid, solids, or numbers. */
  async stage(episode) {
    const { name } = this;
    const isGrid = "cells" in episode.task.observation;
    let solids = null;
    if (!isGrid && episode.task.deterministic !== false) {
      try {
        solids = await api.scenes(name, this.asking.signal);
      } catch (error) {
        if (this.name === name) this.complain(error.message);
      }
    }
    if (this.name !== name) return;
    const Kind = isGrid ? GridStage : solids && SolidStage.isPossible() ? SolidStage : NumberStage;
    if (solids && Kind === NumberStage) this.complain("This browser has no WebGL: showing numbers, not solids.");
    this.enter(Kind);
    await this.shown.take(episode, solids);
    this.extras.replaceChildren(...(isGrid ? this.heat() : []), ...(this.details.renders ? [this.rendering()] : []));
  }

  /** Changes to a stage of this kind, unless it is already shown. */
  enter(Kind) {
    if (this.shown instanceof Kind) return;
    this.shown?.close();
    this.shown = new Kind();
    this.stagePlace.replaceChildren(this.shown.place);
  }

  /** Returns a button that has the environment render the episode, which takes as long as re-simulating it. */
  rendering() {
    const render = button("Render", async () => {
      const { name } = this;
      [render.disabled, render.textContent] = [true, "Rendering"];
      try {
        const found = await api.pictures(name, this.asking.signal);
        if (found.length === 0) throw new Error("The environment renders no pictures: it has no render mode rgb_array.");
        if (this.name !== name) return;
        this.complain("");
        this.enter(PictureStage);
        this.shown.take(found);
        this.shown.show(this.at);
        render.remove();
      } catch (error) {
        if (this.name === name) this.complain(error.message);
        [render.disabled, render.textContent] = [false, "Render"];
      }
    });
    return render;
  }

  /** Returns a menu of checkpoints whose proximity over the grid can be shown; no element if there are none. */
  heat() {
    const checkpoints = this.details.checkpoints.map((number) => element("option", { value: number }, `after ${number} iterations`));
    const choice = element("select", { "aria-label": "Proximity over the grid", onchange: () => this.drawHeat(choice.value) },
      element("option", { value: "" }, "no proximity over the grid"), checkpoints);
    choice.value = this.heated ?? "";
    if (this.heated) this.drawHeat(this.heated);
    return checkpoints.length > 0 ? [choice] : [];
  }

  async drawHeat(checkpoint) {
    this.heated = checkpoint;
    if (!checkpoint) {
      this.shown.heat?.(null);
      return;
    }
    const { name } = this;
    const isAsked = () => this.name === name && this.heated === checkpoint;
    try {
      const said = await api.grid(name, checkpoint, this.asking.signal);
      if (isAsked()) this.shown.heat?.(said);
    } catch (error) {
      if (isAsked()) this.complain(error.message);
    }
  }

  async drawCurves(episode) {
    this.recorded = episode;
    this.other = null;
    this.draw();
    if (episode.proximity.length > 0 || this.details.checkpoints.length === 0) return;
    // The episode was not scored: the newest model estimates it, if it can score single observations.
    const { name } = this;
    const said = await api.proximity(name, this.asking.signal).catch(() => episode);
    if (this.name !== name) return;
    this.recorded = { ...episode, proximity: said.proximity, uncertainty: said.uncertainty };
    this.draw();
  }

  /** Draws the recorded score and, over it, the score under another reward. */
  draw() {
    const { recorded, other } = this;
    const scored = recorded.rewards.length > 0;
    const line = (kind, values, name, dashed) => ({
      name, color: COLORS[kind], dashed,
      // A model of transitions or actions scores each step, not each observation.
      points: values.map((value, index) => [index + this.last + 1 - values.length, value]),
    });
    const lines = {
      proximity: [line("proximity", recorded.proximity, "proximity")],
      uncertainty: [line("uncertainty", recorded.uncertainty, "uncertainty")],
      reward: [line("reward", scored ? recorded.rewards : recorded.environment_rewards, scored ? "reward" : "the environment's reward")],
    };
    if (other) {
      for (const kind of ["proximity", "uncertainty"]) lines[kind].push(line(kind, other[kind], "otherwise", true));
      lines.reward.push(line("reward", other.rewards, "otherwise", true));
    }
    for (const [kind, chart] of Object.entries(this.charts)) {
      chart.draw(lines[kind], "step");
      chart.mark(this.at);
    }
  }

  complain(line) {
    this.trouble.hidden = line === "";
    this.trouble.textContent = line;
  }

  /** Shows a step. */
  seek(step) {
    if (!this.episode) return;
    this.at = Math.min(Math.max(step, 0), this.last);
    this.timeline.value = this.at;
    this.shown?.show(this.at);
    for (const chart of Object.values(this.charts)) chart.mark(this.at);
    const { proximity } = this.recorded;
    const score = proximity[this.at - (this.last + 1 - proximity.length)];
    this.told.textContent = `step ${this.at} of ${this.last}${score === undefined ? "" : `, proximity ${short(score)}`}`;
    this.follower?.seek(Math.min(this.at, this.follower.last));
  }

  toggle() {
    if (this.isPlaying) this.stop();
    else {
      if (this.at >= this.last) this.seek(0);
      this.start();
    }
  }

  start() {
    if (!this.episode) return;
    cancelAnimationFrame(this.ticket);
    [this.isPlaying, this.begun] = [true, null];
    this.button.textContent = "Pause";
    this.ticket = requestAnimationFrame((now) => this.tick(now));
  }

  stop() {
    this.isPlaying = false;
    this.button.textContent = "Play";
    cancelAnimationFrame(this.ticket);
  }

  tick(now) {
    if (!this.isPlaying) return;
    this.begun ??= { now, at: this.at };
    const pace = PACE["cells" in this.episode.task.observation ? "cells" : "vector"] * Number(this.speed.value);
    const step = this.begun.at + Math.floor(((now - this.begun.now) / 1000) * pace);
    if (step !== this.at) this.seek(step);
    // If the timeline was moved or the speed was changed, playing goes on from the current step.
    if (this.at !== step || this.pace !== pace) this.begun = { now, at: this.at };
    this.pace = pace;
    if (this.at >= this.last) this.stop();
    else this.ticket = requestAnimationFrame((next) => this.tick(next));
  }

  resize() {
    this.shown?.resize?.();
  }

  close() {
    this.name = null;
    this.asking?.abort();
    this.stop();
    this.shown?.close();
  }
}

function caption([, collection, row], episode) {
  const { lane, iteration } = episode;
  return `${collection}, row ${row}: lane ${lane}, episode ${episode.episode}, iteration ${iteration}; ${end(episode)}`;
}

function end({ success, steps_to_goal: reached, steps }) {
  // The task does not tell success.
  if (success === null) return `${steps} steps`;
  return success ? `reached the goal after ${reached} of ${steps} steps` : `missed the goal in ${steps} steps`;
}
