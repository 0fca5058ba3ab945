// Pointers on the map: they move the view, draw goals and zones, measure, and select robots.

/** Movement up to which a press is a click, pixels. */
const CLICK_PX = 6;

/**
 * Listens to the pointers and the wheel on the map.
 * @param {object} of
 * @param {import("./view.js").View} of.view
 * @param {import("./state.js").Fleet} of.fleet
 * @param {import("./map_tools.js").MapTools} of.tools
 * @param {(robot: number) => void} of.select
 * @param {(factor: number, pixel: {x: number, y: number}) => void} of.zoom
 * @param {() => void} of.show the view has changed
 */
export function attachPointers({ view, fleet, tools, select, zoom, show }) {
  const { canvas, camera } = view;
  /** Where the pointers are, pixels. @type {Map<number, {x: number, y: number, moved: number}>} */
  const pointers = new Map();
  const pixelOf = (/** @type {MouseEvent} */ event) => ({ x: event.offsetX, y: event.offsetY });

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, { ...pixelOf(event), moved: 0 });
    tools.press(camera.toWorld(pixelOf(event)));
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    const pixel = pixelOf(event);
    const [dx, dy] = [pixel.x - pointer.x, pixel.y - pointer.y];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) tools.cancel();
    if (tools.isHeld) {
      tools.move(camera.toWorld(pixel));
    } else if (other) {
      const before = Math.hypot(pointer.x - other.x, pointer.y - other.y);
      const after = Math.hypot(pixel.x - other.x, pixel.y - other.y);
      if (before > 0) zoom(after / before, other);
    } else if (pointer.moved + Math.hypot(dx, dy) > CLICK_PX) {
      view.fits = false;
      view.followed = null;
      camera.pan(dx, dy);
      show();
    }
    pointers.set(event.pointerId, { ...pixel, moved: pointer.moved + Math.hypot(dx, dy) });
  });
  canvas.addEventListener("pointerup", (event) => {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    if (tools.isHeld) {
      tools.release();
    } else if (pointer && pointer.moved <= CLICK_PX) {
      const number = view.robotAt(fleet, pointer);
      if (number !== null) select(number);
    }
  });
  canvas.addEventListener("pointercancel", (event) => {
    pointers.delete(event.pointerId);
    tools.cancel();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015), pixelOf(event));
  }, { passive: false });
}
