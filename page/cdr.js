// CDR, the encoding of ROS 2 messages: a reader and a writer (OMG CDR, version 1, with a header of 4 bytes).

/** Bytes before the message: the representation and two bytes of options. */
const HEADER_BYTES = 4;
const text = new TextDecoder();

/** Reads the fields of a message one after the other. Every method throws a RangeError past the end. */
export class CdrReader {
  /** @param {DataView} view the message with its header */
  constructor(view) {
    if (view.byteLength < HEADER_BYTES || view.getUint8(0) !== 0 || view.getUint8(1) > 1) {
      throw new RangeError("not a CDR message");
    }
    this.view = view;
    this.little = view.getUint8(1) === 1;
    this.at = HEADER_BYTES;
  }

  /** Moves to the next multiple of the size of a number, counted from the end of the header. */
  align(/** @type {number} */ size) {
    this.at = HEADER_BYTES + Math.ceil((this.at - HEADER_BYTES) / size) * size;
  }

  /** Skips to the place behind a number, and returns its own place. */
  place(/** @type {number} */ size) {
    this.align(size);
    const at = this.at;
    this.at += size;
    return at;
  }

  bool() { return this.view.getUint8(this.place(1)) !== 0; }
  i32() { return this.view.getInt32(this.place(4), this.little); }
  u32() { return this.view.getUint32(this.place(4), this.little); }
  f32() { return this.view.getFloat32(this.place(4), this.little); }
  f64() { return this.view.getFloat64(this.place(8), this.little); }

  /** Returns a length after checking that so many items of this size can follow. */
  length(/** @type {number} */ itemBytes) {
    const length = this.u32();
    if (length * itemBytes > this.view.byteLength - this.at) {
      throw new RangeError(`${length} items cannot follow`);
    }
    return length;
  }

  /** Returns bytes of the message, which are not copied. */
  bytes(/** @type {number} */ count) {
    if (count > this.view.byteLength - this.at) {
      throw new RangeError(`${count} bytes cannot follow`);
    }
    const bytes = new Uint8Array(this.view.buffer, this.view.byteOffset + this.at, count);
    this.at += count;
    return bytes;
  }

  /** Returns a string without the NUL at its end. */
  string() {
    const bytes = this.bytes(this.length(1));
    return text.decode(bytes.length > 0 && bytes[bytes.length - 1] === 0 ? bytes.subarray(0, -1) : bytes);
  }

  /** Returns a sequence of float32. */
  f32s() {
    const length = this.length(4);
    this.align(4);
    const values = new Float32Array(length);
    for (let i = 0; i < length; i += 1) values[i] = this.f32();
    return values;
  }

  /** Returns seconds. */
  time() {
    const seconds = this.i32();
    return seconds + this.u32() * 1e-9;
  }

  header() { return { stamp: this.time(), frame: this.string() }; }
  vector() { return { x: this.f64(), y: this.f64(), z: this.f64() }; }
  quaternion() { return { x: this.f64(), y: this.f64(), z: this.f64(), w: this.f64() }; }
}

/** Writes the fields of a message one after the other. */
export class CdrWriter {
  constructor() {
    /** @type {number[]} */
    this.bytes = [0, 1, 0, 0];
  }

  /** @param {number} size @param {(view: DataView) => void} set */
  number(size, set) {
    while ((this.bytes.length - HEADER_BYTES) % size !== 0) this.bytes.push(0);
    const view = new DataView(new ArrayBuffer(size));
    set(view);
    for (let i = 0; i < size; i += 1) this.bytes.push(view.getUint8(i));
    return this;
  }

  bool(/** @type {boolean} */ value) { return this.number(1, (view) => view.setUint8(0, value ? 1 : 0)); }
  i32(/** @type {number} */ value) { return this.number(4, (view) => view.setInt32(0, value, true)); }
  u32(/** @type {number} */ value) { return this.number(4, (view) => view.setUint32(0, value, true)); }
  f32(/** @type {number} */ value) { return this.number(4, (view) => view.setFloat32(0, value, true)); }
  f64(/** @type {number} */ value) { return this.number(8, (view) => view.setFloat64(0, value, true)); }
  /** Writes a string with a NUL at its end. */
  string(/** @type {string} */ value) {
    const bytes = new TextEncoder().encode(value);
    this.number(4, (view) => view.setUint32(0, bytes.length + 1, true));
    this.bytes.push(...bytes, 0);
    return this;
  }

  done() { return new Uint8Array(this.bytes); }
}
