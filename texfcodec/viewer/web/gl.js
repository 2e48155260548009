// WebGL2 in a few words: programs, textures that hold rows of numbers, and pictures to draw into.

export class DeviceError extends Error {}

/** A context for a canvas, or a DeviceError that says what is missing. */
export function openContext(canvas) {
  const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, preserveDrawingBuffer: true });
  if (gl === null) throw new DeviceError('This browser has no WebGL2, which the page draws with.');
  return gl;
}

/** A program; its uniforms are found by name and remembered. Errors carry the shader's log. */
export class Program {
  constructor(gl, vertex, fragment) {
    this.gl = gl;
    this.handle = gl.createProgram();
    const shaders = [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([kind, text]) => {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(this.handle, shader);
      return shader;
    });
    ATTRIBUTES.forEach((name, number) => gl.bindAttribLocation(this.handle, number, name));
    gl.linkProgram(this.handle);
    if (!gl.getProgramParameter(this.handle, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`${gl.getProgramInfoLog(this.handle)} ${shaders.map((s) => gl.getShaderInfoLog(s)).join(' ')}`);
    }
    shaders.forEach((shader) => gl.deleteShader(shader));
    this.places = new Map();
  }

  place(name) {
    if (!this.places.has(name)) this.places.set(name, this.gl.getUniformLocation(this.handle, name));
    return this.places.get(name);
  }

  /** Sets uniforms by the shape of their values: numbers as floats, arrays of 2 to 4 as vectors. */
  set(values) {
    for (const [name, value] of Object.entries(values)) {
      const place = this.place(name);
      if (place === null) continue;
      if (typeof value === 'number') this.gl.uniform1f(place, value);
      else this.gl[`uniform${value.length}fv`](place, value);
    }
  }

  setInteger(name, ...values) {
    if (this.place(name) !== null) this.gl[`uniform${values.length}i`](this.place(name), ...values);
  }

  /** Binds a texture to a unit under a name. */
  texture(name, texture, unit) {
    if (this.place(name) === null) return;
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(this.gl.TEXTURE_2D, texture);
    this.gl.uniform1i(this.place(name), unit);
  }
}

export const ATTRIBUTES = ['a_position', 'a_normal', 'a_tangent', 'a_uv0', 'a_uv1', 'a_uv2', 'a_uv3', 'a_colour'];

const FORMATS = {
  rgba8: ['RGBA8', 'RGBA', 'UNSIGNED_BYTE', 4], rg8: ['RG8', 'RG', 'UNSIGNED_BYTE', 2], r8: ['R8', 'RED', 'UNSIGNED_BYTE', 1],
  rg32ui: ['RG32UI', 'RG_INTEGER', 'UNSIGNED_INT', 2], r32ui: ['R32UI', 'RED_INTEGER', 'UNSIGNED_INT', 1],
  rgba32f: ['RGBA32F', 'RGBA', 'FLOAT', 4], rgb16ui: ['RGBA16UI', 'RGBA_INTEGER', 'UNSIGNED_SHORT', 4],
};

/** Logarithm of the width of textures that hold rows: 4096 is what every device has room for beside as many rows. */
export const ROW_LOG2 = 11;

/** A texture that holds `count` texels of a format, 2**ROW_LOG2 a row, for texelFetch. */
export function tableTexture(gl, format, data, what) {
  const [, , , components] = FORMATS[format], width = 1 << ROW_LOG2;
  const count = Math.max(1, data.length / components), height = Math.ceil(count / width);
  const padded = new data.constructor(width * height * components);
  padded.set(data);
  return imageTexture(gl, format, [{ width, height, values: padded }], what);
}

/** A texture of levels [{ width, height, values }], each half the size of the last, for texelFetch. */
export function imageTexture(gl, format, levels, what) {
  const [internal, layout, type] = FORMATS[format];
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  checkSize(gl, levels[0].width, levels[0].height, what);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texStorage2D(gl.TEXTURE_2D, levels.length, gl[internal], levels[0].width, levels[0].height);
  levels.forEach(({ width, height, values }, number) => {
    gl.texSubImage2D(gl.TEXTURE_2D, number, 0, 0, width, height, gl[layout], gl[type], values);
  });
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, levels.length > 1 ? gl.NEAREST_MIPMAP_NEAREST : gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return texture;
}

/** Throws a DeviceError where a texture is larger than the device takes. */
export function checkSize(gl, width, height, what) {
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (width > most || height > most) {
    throw new DeviceError(`${what} needs a texture of ${width} x ${height}; this device takes at most ${most} x ${most}.`);
  }
}

/** A picture to draw into: colour RGBA8 (or what is said), depth as a texture where it is asked later. */
export class Target {
  constructor(gl, width, height, format = 'rgba8') {
    this.gl = gl;
    Object.assign(this, { width, height });
    checkSize(gl, width, height, 'The picture');
    this.colour = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.colour);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl[FORMATS[format][0]], width, height);
    this.depth = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.depth);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT32F, width, height);
    for (const texture of [this.colour, this.depth]) {
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.colour, 0);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depth, 0);
  }

  bind() {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.frame);
    this.gl.viewport(0, 0, this.width, this.height);
  }

  /** Pixels as bytes (Uint8Array) or floats, the bottom row first. */
  read(floats = false) {
    const out = new (floats ? Float32Array : Uint8Array)(this.width * this.height * 4);
    this.bind();
    this.gl.readPixels(0, 0, this.width, this.height, this.gl.RGBA, floats ? this.gl.FLOAT : this.gl.UNSIGNED_BYTE, out);
    return out;
  }

  free() {
    this.gl.deleteFramebuffer(this.frame);
    this.gl.deleteTexture(this.colour);
    this.gl.deleteTexture(this.depth);
  }
}
