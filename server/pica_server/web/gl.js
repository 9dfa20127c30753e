/**
 * What WebGL offers, and its objects: programs, textures, what is drawn into. Shaders are the files
 * of the Python package in GLSL ES 3.00, composed as `render/gpu_program.py` does; the relay gives
 * all texts in one answer, `shaders.json`.
 */

/** @typedef {ReturnType<typeof openGraphics>} Graphics */
/**
 * @typedef {{handle: WebGLTexture, kind: number, width: number, height: number, format: Format}}
 * Texture */
/** @typedef {{framebuffer: WebGLFramebuffer | null, width: number, height: number}} Target */
/** @typedef {{handle: WebGLProgram, set: Record<string, (value: any) => void>}} Program */
/** @typedef {ReturnType<Graphics["triangles"]>} Triangles */
/**
 * @typedef {"RGBA8" | "RGBA16F" | "RGBA32F" | "RG16F" | "RG32F" | "RGB8" | "RGB32F" | "RGB16UI" |
 * "DEPTH"} Format */

const ATTRIBUTES = ["vertex_place", "vertex_uv", "vertex_xyz_m", "vertex_opacity"];
const KINDS = ["float", "int", "sampler2D", "sampler2DArray", "usampler2DArray"];

/** What this browser and GPU cannot draw with. */
export class DrawError extends Error {}

/**
 * A context, its formats and what is compiled once.
 * @param {WebGL2RenderingContext} gl @param {Record<string, string>} texts Shaders by name.
 * @param {boolean} onlyHalfs Draw as where 32-bit floats can be neither targets nor filtered.
 */
export function openGraphics(gl, texts, onlyHalfs = false) {
  const hasFloats = gl.getExtension("EXT_color_buffer_float") !== null && !onlyHalfs;
  if (!hasFloats && !gl.getExtension("EXT_color_buffer_half_float") && !onlyHalfs) {
    throw new DrawError(
      "this browser's graphics cannot draw floating-point numbers; try another browser");
  }
  const isFiltered = hasFloats && gl.getExtension("OES_texture_float_linear");
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = String(gl.getParameter(info?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
  /** A vertex array without attributes, for rectangles. */
  const nothing = gl.createVertexArray();
  /** Keyed by the fragment shader's text. @type {Map<string, Program>} */
  const screens = new Map();

  /** The text of a shader, in which each include is replaced. @param {string} name
   * @param {Record<string, string | number>} defines @param {string} generated Included as
   * `siren.glsl`. */
  function compose(name, defines = {}, generated = "") {
    /** @type {(file: string) => string} */
    const included = (file) => {
      const text = file === "siren.glsl" ? generated : texts[file];
      if (text === undefined) throw new DrawError(`shader ${file} is missing on the relay`);
      return text.replace(/^#include "([^"]*)".*$/gm, (_, other) => included(other));
    };
    const header = KINDS.map((kind) => `precision highp ${kind};`);
    const sizes = Object.entries(defines).map(([key, value]) => `#define ${key} ${value}`);
    return ["#version 300 es", ...header, ...sizes, included(name)].join("\n");
  }

  /** Compile and link two texts. @type {(vertex: string, fragment: string) => Program} */
  function program(vertex, fragment) {
    const handle = gl.createProgram();
    const shaders =
      [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]].map(([kind, text]) => {
      const shader = /** @type {WebGLShader} */ (gl.createShader(Number(kind)));
      gl.shaderSource(shader, String(text));
      gl.compileShader(shader);
      gl.attachShader(handle, shader);
      return shader;
    });
    ATTRIBUTES.forEach((name, index) => gl.bindAttribLocation(handle, index, name));
    gl.linkProgram(handle);
    if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs =
        [...shaders.map((shader) => gl.getShaderInfoLog(shader)), gl.getProgramInfoLog(handle)];
      throw new DrawError(
        `the graphics driver refuses a shader: ${logs.find(Boolean) ?? "no reason given"}`);
    }
    shaders.forEach((shader) => gl.deleteShader(shader));
    return { handle, set: setters(handle) };
  }

  /** What sets each uniform, samplers to textures. @param {WebGLProgram} handle */
  function setters(handle) {
    gl.useProgram(handle);
    /** @type {Program["set"]} */
    const set = {};
    let units = 0;
    const count = gl.isContextLost() ? 0 : gl.getProgramParameter(handle, gl.ACTIVE_UNIFORMS);
    for (let index = 0; index < count; ++index) {
      const { name, type } = /** @type {WebGLActiveInfo} */ (gl.getActiveUniform(handle, index));
      const place = gl.getUniformLocation(handle, name);
      /** @type {Record<number, (value: any) => void>} */
      const byType = {
        [gl.FLOAT]: (value) => gl.uniform1f(place, value),
        [gl.INT]: (value) => gl.uniform1i(place, value),
        [gl.BOOL]: (value) => gl.uniform1i(place, value),
        [gl.FLOAT_VEC2]: (value) => gl.uniform2fv(place, value),
        [gl.FLOAT_VEC3]: (value) => gl.uniform3fv(place, value),
        [gl.FLOAT_VEC4]: (value) => gl.uniform4fv(place, value),
        [gl.FLOAT_MAT3]: (value) => gl.uniformMatrix3fv(place, false, value),
        [gl.FLOAT_MAT4]: (value) => gl.uniformMatrix4fv(place, true, value),
      };
      const unit = units;
      set[name.replace("[0]", "")] = byType[type] ?? ((texture) => bind(texture, unit));
      if (!byType[type]) gl.uniform1i(place, units++);
    }
    set.rect?.([-1, -1, 1, 1]);
    return set;
  }

  /** A program that covers a rectangle, compiled once. @param {string} name
   * @param {Record<string, string | number>} defines @param {string} generated */
  function screen(name, defines = {}, generated = "") {
    const fragment = compose(name, defines, generated);
    const found = screens.get(fragment) ?? program(compose("rect.vert"), fragment);
    screens.set(fragment, found);
    return found;
  }

  /** @param {Program} each */
  function forget(each) {
    gl.deleteProgram(each.handle);
    screens.forEach((known, text) => known === each && screens.delete(text));
  }

  /** Take a program and what its uniforms are. @param {Program} each
   * @param {Record<string, any>} uniforms */
  function use(each, uniforms) {
    gl.useProgram(each.handle);
    for (const [name, value] of Object.entries(uniforms)) if (value !== undefined) {
      each.set[name]?.(value);
    }
  }

  /** Draw into it from now on. @param {Target} target */
  function into({ framebuffer, width, height }) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(0, 0, width, height);
  }

  /** Draw a rectangle. @param {Program} each @param {Target} target
   * @param {Record<string, any>} uniforms */
  function draw(each, target, uniforms) {
    into(target);
    use(each, uniforms);
    gl.bindVertexArray(nothing);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  /** @param {Program} each @param {Triangles} mesh @param {Record<string, any>} uniforms */
  function drawMesh(each, mesh, uniforms, copies = 1) {
    use(each, uniforms);
    gl.bindVertexArray(mesh.vertices);
    gl.drawElementsInstanced(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0, copies);
  }

  /** @param {Texture} texture */
  function bind({ kind, handle }, unit = 0) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, handle);
  }

  /** Internal format, format and type. @param {Format} format @returns {[number, number,
   * number]} */
  function formats(format) {
    if (format === "DEPTH") return [gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT];
    if (format === "RGB16UI") return [gl.RGB16UI, gl.RGB_INTEGER, gl.UNSIGNED_SHORT];
    const components = format.startsWith("RGBA") ? gl.RGBA : format.startsWith("RGB")
      ? gl.RGB : gl.RG;
    return [gl[format], components, format.endsWith("F") ? gl.FLOAT : gl.UNSIGNED_BYTE];
  }

  /** A texture; with layers, an array of them. @param {Format} format @param {number} width
   * @param {number} height @param {{smooth?: boolean, levels?: number, layers?: number}} options
   * @returns {Texture} */
  function texture(format, width, height, { smooth = false, levels = 1, layers = 0 } = {}) {
    const kind = layers ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
    const found = { handle: gl.createTexture(), kind, width, height, format };
    bind(found);
    const [internal] = formats(format);
    if (layers) gl.texStorage3D(kind, 1, internal, width, height, layers);
    else gl.texStorage2D(kind, levels, internal, width, height);
    const filter = smooth ? gl.LINEAR : gl.NEAREST;
    gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, levels > 1 ? gl.LINEAR_MIPMAP_LINEAR : filter);
    gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, filter);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    return found;
  }

  /** Fill a texture, its first rows, or a layer of it. @param {Texture} each
   * @param {ArrayBufferView} data */
  function write(each, data, layer = 0, rows = each.height) {
    const [, components, type] = formats(each.format);
    bind(each);
    if (each.kind === gl.TEXTURE_2D)
      gl.texSubImage2D(each.kind, 0, 0, 0, each.width, rows, components, type, data);
    else gl.texSubImage3D(each.kind, 0, 0, 0, layer, each.width, rows, 1, components, type, data);
    return each;
  }

  /** What draws into textures. @param {Texture[]} colours @param {Texture | null} depth @returns
   * {Target} */
  function target(colours, depth = null) {
    const framebuffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    const places = colours.map((_, index) => gl.COLOR_ATTACHMENT0 + index);
    const images = [...colours, ...(depth ? [depth] : [])];
    images.forEach(({ handle }, index) => {
      gl.framebufferTexture2D(gl.FRAMEBUFFER, places[index]
        ?? gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, handle, 0);
    });
    gl.drawBuffers(places);
    return { framebuffer, width: images[0].width, height: images[0].height };
  }

  /** Triangles of vertices that have these numbers each. @param {Uint32Array} faces
   * @param {Float32Array} corners @param {[string, number][]} layout */
  function triangles(faces, corners, layout) {
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

  /** Free textures, meshes and what is drawn into.
   * @param {(Texture | Target | Triangles | null | undefined)[]} things */
  function free(...things) {
    for (const thing of things) {
      if (!thing) continue;
      if ("handle" in thing) gl.deleteTexture(thing.handle);
      if ("framebuffer" in thing) gl.deleteFramebuffer(thing.framebuffer);
      if ("vertices" in thing) gl.deleteVertexArray(thing.vertices);
      if ("buffers" in thing) thing.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
    }
  }

  return {
    gl, renderer, compose, program, screen, forget, into, draw, drawMesh, texture, write, target,
      triangles, free,
    /** What is between two passes, and what is filtered. */
    exact: /** @type {Format} */ (hasFloats ? "RGBA32F" : "RGBA16F"),
    pairs: /** @type {Format} */ (hasFloats ? "RG32F" : "RG16F"),
    smooth: /** @type {Format} */ (isFiltered ? "RGBA32F" : "RGBA16F"),
    /** Whether the processor draws. */
    isSoftware: /swiftshader|llvmpipe|software|basic render/i.test(renderer),
  };
}
