// A small WebGL 2 renderer: lit triangles, textured rectangles, points, and what real things hide of them.

import { VERTEX_NUMBERS } from "./models.js";
import { POINTS, ROOM, SOLID, TEXTURED } from "./shaders.js";

/** @typedef {import("./matrix.js").Matrix} Matrix */
/** @typedef {[number, number, number, number]} Colour red, green, blue, opacity: 0 to 1 */

/**
 * @typedef {object} Drawable triangles or points on the graphics processor
 * @property {WebGLVertexArrayObject} array
 * @property {WebGLBuffer} buffer
 * @property {number} count corners
 * @property {WebGLBuffer} [indices]
 */

/**
 * @typedef {object} Depth the device's depth of one view
 * @property {WebGLTexture} texture an array of layers
 * @property {number} layer
 * @property {ArrayLike<number>} depthFromView from the view's coordinates, 0 to 1, to the texture's
 * @property {number} near metres, 0 if the texture holds metres @property {number} far metres, 0 if infinite
 * @property {number} metresOfRaw
 */

/**
 * @typedef {object} Eye one view of a frame
 * @property {ArrayLike<number>} view @property {ArrayLike<number>} projection
 * @property {{x: number, y: number, width: number, height: number}} viewport
 * @property {[number, number, number]} place of the eye in the room @property {Depth | null} depth
 */

/** How something is drawn. @typedef {{ignoresDepth?: boolean, light?: number, opacity?: number}} Options */

/** A linked program with the places of its uniforms. */
class Program {
  /** @param {WebGL2RenderingContext} gl @param {{vertex: string, fragment: string}} source */
  constructor(gl, { vertex, fragment }) {
    this.gl = gl;
    const program = gl.createProgram();
    for (const [type, text] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(type));
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`a shader does not compile: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`the shaders do not fit: ${gl.getProgramInfoLog(program)}`);
    }
    this.program = program;
    /** @type {Map<string, WebGLUniformLocation | null>} */
    this.places = new Map();
  }

  at(/** @type {string} */ name) {
    let place = this.places.get(name);
    if (place === undefined) {
      place = this.gl.getUniformLocation(this.program, name);
      this.places.set(name, place);
    }
    return place;
  }
}

/** Unit of the depth texture; images use unit 0. */
const DEPTH_UNIT = 1;

/** Draws into the framebuffer of a session. */
export class Renderer {
  /** @param {WebGL2RenderingContext} gl */
  constructor(gl) {
    this.gl = gl;
    this.programs = {
      solid: new Program(gl, SOLID), textured: new Program(gl, TEXTURED),
      points: new Program(gl, POINTS), room: new Program(gl, ROOM),
    };
    this.square = this.createDrawable([[2, 2, 0]], new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]), 2);
    // A sampler needs a texture even where none is read.
    this.noDepth = this.createTexture(gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.R8, 1, 1, 1, 0, gl.RED, gl.UNSIGNED_BYTE, new Uint8Array(4));
    /** @type {Eye | null} */
    this.eye = null;
  }

  /** @param {number} target @param {number} [filter] when it is seen smaller @param {number} [magnify] @returns {WebGLTexture} bound, with clamped edges */
  createTexture(target, filter = this.gl.NEAREST, magnify = this.gl.NEAREST) {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(target, texture);
    gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, magnify);
    gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return texture;
  }

  /**
   * Creates triangles or points. @param {number[][]} layout of each attribute: numbers, numbers of a corner, first number
   * @param {Float32Array} numbers @param {number} perCorner @param {Uint32Array} [indices] @returns {Drawable}
   */
  createDrawable(layout, numbers, perCorner, indices) {
    const { gl } = this;
    const [array, buffer] = [gl.createVertexArray(), gl.createBuffer()];
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
    layout.forEach(([size, stride, first], place) => {
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride * 4, first * 4);
    });
    /** @type {Drawable} */
    const drawable = { array, buffer, count: indices ? indices.length : numbers.length / perCorner };
    if (indices) {
      drawable.indices = gl.createBuffer();
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, drawable.indices);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    }
    gl.bindVertexArray(null);
    return drawable;
  }

  /** @param {import("./models.js").Mesh} mesh */
  createMesh(mesh) {
    return this.createDrawable([[3, VERTEX_NUMBERS, 0], [3, VERTEX_NUMBERS, 3], [1, VERTEX_NUMBERS, 6]], mesh.vertices, VERTEX_NUMBERS);
  }

  /** Creates points or the corners of a room's mesh. @param {Float32Array} places @param {Uint32Array} [indices] */
  createPlaces(places, indices) { return this.createDrawable([[3, 3, 0]], places, 3, indices); }

  /** Puts other corners into a drawable. @param {Drawable} drawable @param {Float32Array} numbers @param {number} perCorner */
  update(drawable, numbers, perCorner) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, drawable.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.DYNAMIC_DRAW);
    drawable.count = numbers.length / perCorner;
  }

  delete(/** @type {Drawable} */ { array, buffer, indices }) {
    this.gl.deleteVertexArray(array);
    this.gl.deleteBuffer(buffer);
    if (indices) this.gl.deleteBuffer(indices);
  }

  /** Gives all that it has on the graphics processor back: nothing is drawn any more. */
  dispose() { this.gl.getExtension("WEBGL_lose_context")?.loseContext(); }

  /** Begins a frame. @param {WebGLFramebuffer | null} framebuffer */
  begin(framebuffer) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.CULL_FACE);
    gl.colorMask(true, true, true, true);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    gl.clearDepth(1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Begins the view of one eye. @param {Eye} eye */
  beginView(eye) {
    const { gl } = this;
    this.eye = eye;
    gl.viewport(eye.viewport.x, eye.viewport.y, eye.viewport.width, eye.viewport.height);
    gl.activeTexture(gl.TEXTURE0 + DEPTH_UNIT);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, eye.depth?.texture ?? this.noDepth);
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Sets what all programs share. @param {Program} program @param {ArrayLike<number>} model @param {boolean} ignoresDepth */
  use(program, model, ignoresDepth) {
    const { gl, eye } = this;
    if (!eye) throw new Error("a view must be begun first");
    gl.useProgram(program.program);
    gl.uniformMatrix4fv(program.at("model"), false, /** @type {Float32Array} */ (model));
    gl.uniformMatrix4fv(program.at("view"), false, /** @type {Float32Array} */ (eye.view));
    gl.uniformMatrix4fv(program.at("projection"), false, /** @type {Float32Array} */ (eye.projection));
    gl.uniform1i(program.at("ignoresDepth"), Number(ignoresDepth));
    gl.uniform1i(program.at("depthTexture"), DEPTH_UNIT);
    gl.uniform1i(program.at("hasDepth"), Number(eye.depth !== null));
    const { viewport: { x, y, width, height }, place, depth } = eye;
    gl.uniform4f(program.at("viewport"), x, y, width, height);
    gl.uniform3f(program.at("eye"), ...place);
    if (!depth) return;
    gl.uniform1i(program.at("depthLayer"), depth.layer);
    gl.uniformMatrix4fv(program.at("depthFromView"), false, /** @type {Float32Array} */ (depth.depthFromView));
    gl.uniform2f(program.at("depthRange"), depth.near, depth.far);
    gl.uniform1f(program.at("metresOfRaw"), depth.metresOfRaw);
  }

  /** Writes what lies flat or shines through without covering what comes later. @param {boolean} covers */
  setCovers(covers) { this.gl.depthMask(covers); }

  /** Draws things in front of everything, or where they are. @param {boolean} isOnTop */
  setOnTop(isOnTop) {
    if (isOnTop) this.gl.disable(this.gl.DEPTH_TEST);
    else this.gl.enable(this.gl.DEPTH_TEST);
  }

  /** @param {Drawable} mesh @param {ArrayLike<number>} model @param {Colour} colour @param {Options} [options] */
  drawMesh(mesh, model, colour, { ignoresDepth = false, light = 1 } = {}) {
    const { gl, programs: { solid } } = this;
    this.use(solid, model, ignoresDepth);
    gl.uniform4f(solid.at("colour"), ...colour);
    gl.uniform1f(solid.at("light"), light);
    gl.bindVertexArray(mesh.array);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
  }

  /** Draws an image on the square from 0 to 1 of a frame. @param {WebGLTexture} texture @param {ArrayLike<number>} model @param {Options} [options] */
  drawImage(texture, model, { ignoresDepth = false, opacity = 1 } = {}) {
    const { gl, programs: { textured } } = this;
    this.use(textured, model, ignoresDepth);
    gl.uniform1i(textured.at("image"), 0);
    gl.uniform1f(textured.at("opacity"), opacity);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.bindVertexArray(this.square.array);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** @param {Drawable} points @param {ArrayLike<number>} model @param {Colour} colour @param {number} size metres */
  drawPoints(points, model, colour, size) {
    const { gl, programs } = this;
    this.use(programs.points, model, false);
    gl.uniform4f(programs.points.at("colour"), ...colour);
    gl.uniform1f(programs.points.at("size"), size);
    gl.uniform1f(programs.points.at("pixels"), this.eye?.viewport.height ?? 1);
    gl.bindVertexArray(points.array);
    gl.drawArrays(gl.POINTS, 0, points.count);
  }

  /** Draws a part of the room, which is not seen but hides what is behind it. @param {Drawable} mesh @param {ArrayLike<number>} model */
  drawRoom(mesh, model) {
    const { gl, programs } = this;
    this.use(programs.room, model, false);
    gl.colorMask(false, false, false, false);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
    gl.colorMask(true, true, true, true);
  }
}
