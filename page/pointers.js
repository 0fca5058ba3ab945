// Pointers on the map: they move the view, draw goals and zones, measure, and select robots.

/** Movement up to which a press is a click, pixels. */
const CLICK_PX = 6;
/** The primary button of a mouse, a touch or the tip of a pen: as `button`, and in `buttons`. */
export const PRIMARY_BUTTON = 0;
export const PRIMARY_BUTTONS = 1;

/**
 * Listens to the pointers and the wheel on the map.
 * @param {object} of
 * @param {import("./view.js").View} of.view
 * @param {import("./state.js").Fleet} of.fleet
 * @param {import("./map_tools.js").MapTools} of.tools
 * @param {(robot: number) => void} of.select
 * @param {(factor: number, pixel: {x: number, y: number}) => void} of.zoom
 * @param {() => void} of.show the view has changed
 * @param {(text: string, isError: boolean) => void} of.log
 */
export function attachPointers({ view, fleet, tools, select, zoom, show, log }) {
  const { canvas, camera } = view;
  /** Where the pointers are, pixels. @type {Map<number, {x: number, y: number, moved: number}>} */
  const pointers = new Map();
  /** The pointer that draws with a tool. @type {number | null} */
  let drawing = null;
  const pixelOf = (/** @type {MouseEvent} */ event) => ({ x: event.offsetX, y: event.offsetY });

  /** Ends what a pointer did. Other things lie over the map and beside it: there nothing is sent. @param {PointerEvent} event */
  const release = (event) => {
    const pointer = pointers.get(event.pointerId);
    pointers.delete(event.pointerId);
    if (event.pointerId === drawing) {
      drawing = null;
      if (!tools.isHeld) return;
      if (document.elementFromPoint(event.clientX, event.clientY) === canvas) {
        tools.release();
      } else {
        const text = tools.releaseOutside();
        if (text) log(text, true);
      }
    } else if (pointer && pointer.moved <= CLICK_PX) {
      const number = view.robotAt(fleet, pointer);
      if (number !== null) select(number);
    }
  };

  /** Gives up what the pointer draws. */
  const giveUpDrawing = () => {
    if (drawing !== null) tools.cancel();
    drawing = null;
  };

  canvas.addEventListener("pointerdown", (event) => {
    // A mouse's other buttons, and those of a pen, do nothing.
    if (event.button !== PRIMARY_BUTTON) return;
    canvas.setPointerCapture(event.pointerId);
    if (pointers.size > 0) {
      // Two fingers move the view: neither draws, nor selects a robot when it is lifted.
      giveUpDrawing();
      for (const [id, pointer] of pointers) pointers.set(id, { ...pointer, moved: Infinity });
      pointers.set(event.pointerId, { ...pixelOf(event), moved: Infinity });
      return;
    }
    pointers.set(event.pointerId, { ...pixelOf(event), moved: 0 });
    if (tools.press(camera.toWorld(pixelOf(event)))) drawing = event.pointerId;
  });
  canvas.addEventListener("pointermove", (event) => {
    const pointer = pointers.get(event.pointerId);
    if (!pointer) return;
    // While another button is held, the end of the primary one comes as a movement.
    if (!(event.buttons & PRIMARY_BUTTONS)) {
      release(event);
      return;
    }
    const pixel = pixelOf(event);
    const [dx, dy] = [pixel.x - pointer.x, pixel.y - pointer.y];
    const other = [...pointers].find(([id]) => id !== event.pointerId)?.[1];
    if (event.pointerId === drawing) {
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
    if (pointers.has(event.pointerId)) release(event);
  });
  canvas.addEventListener("pointercancel", (event) => {
    pointers.delete(event.pointerId);
    if (event.pointerId === drawing) giveUpDrawing();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0015), pixelOf(event));
  }, { passive: false });
}
