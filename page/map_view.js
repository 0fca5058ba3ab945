// What part of the map is shown: all of it, a place, or what a robot is followed to.

import { element } from "./panels.js";

/** The factor of one step of the zoom. */
const ZOOM_STEP = 1.25;

/** The buttons and keys of the view of the map. */
export class MapView {
  /** @param {import("./view.js").View} view @param {() => number | null} selected @param {(text: string, isError: boolean) => void} log */
  constructor(view, selected, log) {
    this.view = view;
    this.selected = selected;
    this.log = log;
    const [zoomIn, zoomOut] = [() => this.zoom(ZOOM_STEP), () => this.zoom(1 / ZOOM_STEP)];
    /** What keys do with the view, by their codes. @type {Record<string, () => void>} */
    this.keys = {
      KeyF: () => this.setFits(true), KeyC: () => this.toggleFollow(),
      Equal: zoomIn, NumpadAdd: zoomIn, Minus: zoomOut, NumpadSubtract: zoomOut,
    };
    element("fit").addEventListener("click", () => this.setFits(true));
    element("follow").addEventListener("click", () => this.toggleFollow());
    element("zoom-in").addEventListener("click", zoomIn);
    element("zoom-out").addEventListener("click", zoomOut);
  }

  /** @param {boolean} fits */
  setFits(fits) {
    this.view.fits = fits;
    if (fits) this.view.followed = null;
    this.show();
  }

  /** Shows a place in the middle. @param {{x: number, y: number}} place in `map` */
  goTo(place) {
    this.view.followed = null;
    this.setFits(false);
    this.view.camera.center = { ...place };
  }

  toggleFollow() {
    const { view } = this;
    if (this.selected() === null && view.followed === null) {
      this.log("select the robot to follow first", true);
      return;
    }
    view.followed = view.followed === null ? this.selected() : null;
    view.fits = false;
    this.show();
  }

  /** @param {number} factor @param {{x: number, y: number}} [pixel] */
  zoom = (factor, pixel = { x: this.view.camera.width / 2, y: this.view.camera.height / 2 }) => {
    this.view.fits = false;
    this.view.camera.zoom(factor, pixel);
    this.show();
  };

  show = () => {
    element("fit").setAttribute("aria-pressed", String(this.view.fits));
    element("follow").setAttribute("aria-pressed", String(this.view.followed !== null));
  };
}
