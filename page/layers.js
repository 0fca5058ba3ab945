// Which layers of the map are shown: the operator switches them on and off.

/** The layers with their names for the operator, in their order. */
export const LAYERS = /** @type {const} */ ([
  ["seen", "Who saw what"], ["zones", "Keep-out areas"], ["trails", "Trails"], ["scans", "Scans"], ["left", "Places left"], ["goals", "Plans and goals"],
]);

/** @typedef {(typeof LAYERS)[number][0]} Layer */

/** Switches of the layers. All are on at first. */
export class Layers {
  constructor() {
    /** @type {Set<Layer>} */
    this.off = new Set();
  }

  /** Whether a layer is shown. @param {Layer} layer */
  has(layer) { return !this.off.has(layer); }

  /** Switches a layer. @param {Layer} layer @param {boolean} isOn */
  set(layer, isOn) {
    if (isOn) this.off.delete(layer);
    else this.off.add(layer);
  }

  /** Fills an element with the switches. @param {HTMLElement} list */
  attach(list) {
    for (const [layer, name] of LAYERS) {
      const [label, box] = [document.createElement("label"), document.createElement("input")];
      Object.assign(box, { type: "checkbox", checked: true, id: `layer-${layer}` });
      box.addEventListener("change", () => this.set(layer, box.checked));
      label.append(box, ` ${name}`);
      list.append(label);
    }
  }
}
