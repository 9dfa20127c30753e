/** What WebGL offers, and its objects: programs, textures, what is drawn into. */

import { compose } from "./glsl.js";

/** @typedef {WebGL2RenderingContext} GL */
/** @typedef {WebGLTexture & {width: number, height: number}} Texture */
/** @typedef {{framebuffer: WebGLFramebuffer | null, width: number, height: number}} Target */
/** @typedef {{program: WebGLProgram, at: Record<string, WebGLUniformLocation>}} Program */
/** @typedef {"RGBA8" | "RGBA16F" | "RGBA32F" | "RG16F" | "RG32F" | "RGB8" | "RGB32F" | "RGB16UI" | "DEPTH"} Format */

export const ATTRIBUTES = ["vertex_place", "vertex_uv", "vertex_xyz_m", "vertex_opacity"];
/** Texture units by the names of samplers. @type {Record<string, number>} */
export const UNITS = {
  visible_xyz: 0, visible_uv: 1, position_map: 2, expression_map: 3,
  uv_encoding: 4, u_encoding: 5, v_encoding: 6, skin: 7, still_map: 8, room: 0, layer: 1, image: 0,
  phase0: 0, phase1: 1, phase2: 2, phase3: 3, rows: 0, heads: 4, table: 5, places: 6, mean: 7, basis: 8,
};

/** What this browser and GPU cannot draw with. */
export class DrawError extends Error {}

/** A context, its formats and what is compiled once. */
export class Graphics {
  /**
   * @param {GL} gl @param {import("./glsl.js").Texts} texts
   * @param {{onlyHalfs?: boolean}} [options] Draw as where 32-bit floats can be neither targets nor filtered.
   */
  constructor(gl, texts, { onlyHalfs = false } = {}) {
    this.gl = gl;
    this.texts = texts;
    const hasFloats = gl.getExtension("EXT_color_buffer_float") !== null && !onlyHalfs;
    if (!hasFloats && !gl.getExtension("EXT_color_buffer_half_float") && !onlyHalfs) {
      throw new DrawError("this browser's graphics cannot draw floating-point numbers; try another browser");
    }
    /** What is between two passes. @type {Format} */
    this.exact = hasFloats ? "RGBA32F" : "RGBA16F";
    /** @type {Format} */
    this.pairs = hasFloats ? "RG32F" : "RG16F";
    /** What is filtered. @type {Format} */
    this.smooth = hasFloats && gl.getExtension("OES_texture_float_linear") ? "RGBA32F" : "RGBA16F";
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    this.renderer = String(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
    /** Whether the processor draws. */
    this.isSoftware = !onlyHalfs && /swiftshader|llvmpipe|software|basic render/i.test(this.renderer);
    /** A vertex array without attributes, for rectangles. */
    this.nothing = gl.createVertexArray();
    /** @type {Map<string, Program>} Keyed by the fragment shader's text. */
    this._screens = new Map();
  }

  /** Compile and link. @param {string} vertex @param {string} fragment @returns {Program} */
  program(vertex, fragment) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      gl.deleteShader(shader);
    }
    ATTRIBUTES.forEach((name, index) => gl.bindAttribLocation(program, index, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = (gl.getAttachedShaders(program) ?? []).map((shader) => gl.getShaderInfoLog(shader));
      throw new DrawError(`the graphics driver refuses a shader: ${[...logs, gl.getProgramInfoLog(program)].find(Boolean) ?? "no reason given"}`);
    }
    /** @type {Record<string, WebGLUniformLocation>} */
    const at = {};
    gl.useProgram(program);
    const count = gl.isContextLost() ? 0 : gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
    for (let index = 0; index < count; ++index) {
      const name = gl.getActiveUniform(program, index)?.name.replace("[0]", "") ?? "";
      const place = gl.getUniformLocation(program, name);
      if (place) {
        at[name] = place;
        if (name in UNITS) {
          gl.uniform1i(place, UNITS[name]);
        }
      }
    }
    if (at.rect) {
      gl.uniform4f(at.rect, -1, -1, 1, 1);
    }
    return { program, at };
  }

  /** A program that covers a rectangle, compiled once. @param {string} name @param {import("./glsl.js").Defines} [defines] @param {Record<string, string>} [generated] */
  screen(name, defines = {}, generated = {}) {
    const texts = { ...this.texts, ...generated };
    const fragment = compose(texts, name, defines);
    const program = this._screens.get(fragment) ?? this.program(compose(texts, "rect.vert"), fragment);
    this._screens.set(fragment, program);
    return program;
  }

  /** Free a program that `screen` made. @param {Program} screen */
  forget(screen) {
    this.gl.deleteProgram(screen.program);
    this._screens = new Map([...this._screens].filter(([, each]) => each !== screen));
  }

  /** Draw a rectangle by a program into a target. @param {Program} screen @param {Target} target */
  drawScreen({ program }, target) {
    const { gl } = this;
    this.use(target);
    gl.useProgram(program);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** @param {Target} target */
  use({ framebuffer, width, height }) {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, framebuffer);
    this.gl.viewport(0, 0, width, height);
  }

  /** @param {number} unit @param {WebGLTexture} texture @param {number} [kind] */
  bind(unit, texture, kind = this.gl.TEXTURE_2D) {
    this.gl.activeTexture(this.gl.TEXTURE0 + unit);
    this.gl.bindTexture(kind, texture);
  }

  /** @param {Format} format @returns {[number, number, number]} Internal format, format and type. */
  formats(format) {
    const { gl } = this;
    if (format === "DEPTH") {
      return [gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT];
    }
    if (format === "RGB16UI") {
      return [gl.RGB16UI, gl.RGB_INTEGER, gl.UNSIGNED_SHORT];
    }
    const components = format.startsWith("RGBA") ? gl.RGBA : format.startsWith("RGB") ? gl.RGB : gl.RG;
    return [gl[format], components, format.endsWith("F") ? gl.FLOAT : gl.UNSIGNED_BYTE];
  }

  /** @param {Format} format @param {number} width @param {number} height @param {{smooth?: boolean, data?: ArrayBufferView, levels?: number}} [options] @returns {Texture} */
  texture(format, width, height, { smooth = false, data, levels = 1 } = {}) {
    const { gl } = this;
    const [internal, components, type] = this.formats(format);
    const texture = /** @type {Texture} */ (gl.createTexture() ?? {});
    Object.assign(texture, { width, height });
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, levels, internal, width, height);
    if (data) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, components, type, data);
    }
    this._clamp(gl.TEXTURE_2D, smooth);
    if (levels > 1) {
      gl.generateMipmap(gl.TEXTURE_2D);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    }
    return texture;
  }

  /** A texture with layers, and the way to write one. @param {Format} format @param {number} width @param {number} height @param {number} layers */
  layered(format, width, height, layers) {
    const { gl } = this;
    const [internal, components, type] = this.formats(format);
    const texture = gl.createTexture();
    this.bind(0, texture, gl.TEXTURE_2D_ARRAY);
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, internal, width, height, layers);
    this._clamp(gl.TEXTURE_2D_ARRAY, false);
    /** @param {number} layer @param {ArrayBufferView} data */
    const write = (layer, data) => {
      this.bind(0, texture, gl.TEXTURE_2D_ARRAY);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, layer, width, height, 1, components, type, data);
    };
    return { texture, write };
  }

  /** @param {Texture[]} colours @param {Texture | null} [depth] @returns {Target} */
  target(colours, depth = null) {
    const { gl } = this;
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    const places = colours.map((texture, index) => {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + index, gl.TEXTURE_2D, texture, 0);
      return gl.COLOR_ATTACHMENT0 + index;
    });
    gl.drawBuffers(places);
    if (depth) {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, depth, 0);
    }
    const { width, height } = colours[0] ?? depth;
    return { framebuffer, width, height };
  }

  /** Triangles over the vertices that they use: attributes are slices of each vertex's numbers. @param {Uint32Array} faces @param {Float32Array} corners @param {[string, number][]} layout */
  triangles(faces, corners, layout) {
    const { gl } = this;
    const vertices = gl.createVertexArray();
    gl.bindVertexArray(vertices);
    const buffers = [gl.createBuffer(), gl.createBuffer()];
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[0]);
    gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    const stride = 4 * layout.reduce((sum, [, size]) => sum + size, 0);
    let offset = 0;
    for (const [name, size] of layout) {
      const place = ATTRIBUTES.indexOf(name);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, size, gl.FLOAT, false, stride, offset);
      offset += 4 * size;
    }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers[1]);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return { vertices, count: faces.length, buffers };
  }

  /** Free textures and what is drawn into. @param {(Texture | Target | null | undefined)[]} things */
  free(...things) {
    for (const thing of things) {
      if (thing && "framebuffer" in thing) {
        this.gl.deleteFramebuffer(thing.framebuffer);
      } else if (thing) {
        this.gl.deleteTexture(thing);
      }
    }
  }

  /** @param {number} kind @param {boolean} smooth */
  _clamp(kind, smooth) {
    const { gl } = this;
    const filter = smooth ? gl.LINEAR : gl.NEAREST;
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, filter);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  }
}
