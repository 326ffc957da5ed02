// An episode as pictures of its states that its environment renders.

import { element } from "./dom.js";

/** Shows the picture of a state, or the last one before it if the state has none. */
export class PictureStage {
  constructor() {
    this.image = element("img", { alt: "The environment, as it renders itself" });
    this.place = element("div", { class: "picture" }, this.image);
    this.addresses = [];
  }

  /** Takes `pictures`, each with the number of its state and its file. */
  take(pictures) {
    this.close();
    this.states = pictures.map(({ state }) => state);
    this.addresses = pictures.map(({ file }) => URL.createObjectURL(file));
  }

  /** Shows a step. */
  show(step) {
    const next = this.states.findIndex((state) => state > step);
    const address = this.addresses.at(next < 0 ? -1 : next - 1);
    if (this.image.src !== address) this.image.src = address;
  }

  close() {
    for (const address of this.addresses) URL.revokeObjectURL(address);
    this.addresses = [];
  }
}
