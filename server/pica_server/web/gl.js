/**
 * What WebGL offers, and its objects: programs, textures, what is drawn into. Shaders are the files
 * of the Python package in GLSL ES 3.00, composed as `render/gpu_program.py` does; the relay gives
 * all texts in one answer, `shaders.json`.
 */

const ATTRIBUTES = ["vertex_place", "vertex_uv", "vertex_xyz_m", "vertex_opacity"];
const KINDS = ["float", "int", "sampler2D", "sampler2DArray", "usampler2DArray"];

/**
 * A context, its formats and what is compiled once.
 * @param {WebGL2RenderingContext} gl @param {Record<string, string>} texts Shaders by name.
 * @param {boolean} onlyHalfs Draw as where 32-bit floats can be neither targets nor filtered.
 */
export function openGraphics(gl, texts, onlyHalfs = false) {
  const hasFloats = gl.getExtension("EXT_color_buffer_float") !== null && !onlyHalfs;
  if (!hasFloats && !gl.getExtension("EXT_color_buffer_half_float") && !onlyHalfs) {
    throw new Error(
      "this browser's graphics cannot draw floating-point numbers; try another browser");
  }
  const isFiltered = hasFloats && gl.getExtension("OES_texture_float_linear");
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = String(gl.getParameter(info?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
  /** A vertex array without attributes, for rectangles. */
  const nothing = gl.createVertexArray();
  /** Keyed by their texts. @type {Map<string, Program>} */
  const programs = new Map();

  /** The text of a shader, in which each include is replaced.
   * @type {(name: string, defines: Defines, generated: string) => string} */
  function compose(name, defines, generated) {
    /** @type {(file: string) => string} */
    const included = (file) => {
      const text = file === "siren.glsl" ? generated : texts[file];
      if (text === undefined) throw new Error(`shader ${file} is missing on the relay`);
      return text.replace(/^#include "([^"]*)".*$/gm, (_, other) => included(other));
    };
    const header = KINDS.map((kind) => `precision highp ${kind};`);
    const sizes = Object.entries(defines).map(([key, value]) =>
      (value === null ? `uniform int ${key};\n#define ${key} ${key}` : `#define ${key} ${value}`));
    return ["#version 300 es", ...header, ...sizes, included(name)].join("\n");
  }

  /** What sets each uniform, samplers to textures. A program that the driver refuses shows here,
   * at its first use: until then all compile side by side. @param {Program} program */
  function settersOf({ handle }) {
    if (!gl.getProgramParameter(handle, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = (gl.getAttachedShaders(handle) ?? []).map((each) => gl.getShaderInfoLog(each));
      const log = [...logs, gl.getProgramInfoLog(handle)].find(Boolean);
      throw new Error(`the graphics driver refuses a shader: ${log ?? "no reason given"}`);
    }
    gl.useProgram(handle);
    /** @type {Setters} */
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

  /** @param {Texture} texture */
  function bind({ kind, handle }, unit = 0) {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(kind, handle);
  }

  /** Internal format, format and type. @type {(format: Format) => [number, number, number]} */
  function formats(format) {
    if (format === "DEPTH") return [gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT];
    if (format === "RGB16UI") return [gl.RGB16UI, gl.RGB_INTEGER, gl.UNSIGNED_SHORT];
    const components = { RG: gl.RG, RGB: gl.RGB, RGBA: gl.RGBA }[format.replace(/\d.*/, "")];
    return [gl[format], components ?? 0, format.endsWith("F") ? gl.FLOAT : gl.UNSIGNED_BYTE];
  }

  /** @type {Graphics} */
  const graphics = {
    gl,
    exact: hasFloats ? "RGBA32F" : "RGBA16F",
    pairs: hasFloats ? "RG32F" : "RG16F",
    smooth: isFiltered ? "RGBA32F" : "RGBA16F",
    isSoftware: /swiftshader|llvmpipe|software|basic render/i.test(renderer),

    program(vertex, fragment, defines = {}, generated = "") {
      const both = [vertex, fragment].map((name) => compose(name, defines, generated));
      const key = both.join();
      const program = programs.get(key) ?? { handle: gl.createProgram(), set: null, key };
      if (programs.has(key)) return program;
      programs.set(key, program);
      both.forEach((text, index) => {
        const kind = index ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER;
        const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        gl.attachShader(program.handle, shader);
        gl.deleteShader(shader);
      });
      ATTRIBUTES.forEach((name, index) => gl.bindAttribLocation(program.handle, index, name));
      gl.linkProgram(program.handle);
      return program;
    },

    screen: (name, defines, generated) => graphics.program("rect.vert", name, defines, generated),

    forget({ handle, key }) {
      gl.deleteProgram(handle);
      programs.delete(key);
    },

    into({ framebuffer, width, height }) {
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      gl.viewport(0, 0, width, height);
    },

    use(program, uniforms) {
      program.set ??= settersOf(program);
      gl.useProgram(program.handle);
      for (const [name, value] of Object.entries(uniforms)) {
        if (value !== undefined) program.set[name]?.(value);
      }
    },

    draw(program, target, uniforms) {
      graphics.into(target);
      graphics.use(program, uniforms);
      gl.bindVertexArray(nothing);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    },

    drawMesh(program, mesh, uniforms, copies = 1) {
      graphics.use(program, uniforms);
      gl.bindVertexArray(mesh.vertices);
      gl.drawElementsInstanced(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0, copies);
    },

    texture(format, width, height, { smooth = false, levels = 1, isArray = false } = {}) {
      const kind = isArray ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
      const found = { handle: gl.createTexture(), kind, width, height, format };
      bind(found);
      const [internal] = formats(format);
      if (isArray) gl.texStorage3D(kind, 1, internal, width, height, 1);
      else gl.texStorage2D(kind, levels, internal, width, height);
      const filter = smooth ? gl.LINEAR : gl.NEAREST;
      gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, levels > 1 ? gl.LINEAR_MIPMAP_LINEAR : filter);
      gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, filter);
      gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      return found;
    },

    write(texture, data) {
      const { kind, width, height } = texture;
      const [, components, type] = formats(texture.format);
      bind(texture);
      if (kind === gl.TEXTURE_2D) {
        gl.texSubImage2D(kind, 0, 0, 0, width, height, components, type, data);
      } else {
        gl.texSubImage3D(kind, 0, 0, 0, 0, width, height, 1, components, type, data);
      }
      return texture;
    },

    target(colours, depth) {
      const framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
      const places = colours.map((_, index) => gl.COLOR_ATTACHMENT0 + index);
      [...colours, ...(depth ? [depth] : [])].forEach(({ handle }, index) =>
        gl.framebufferTexture2D(gl.FRAMEBUFFER, places[index] ?? gl.DEPTH_ATTACHMENT,
          gl.TEXTURE_2D, handle, 0));
      gl.drawBuffers(places);
      const { width, height } = colours[0];
      return { framebuffer, width, height };
    },

    triangles(faces, corners, layout) {
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
    },

    free(...things) {
      for (const thing of things) {
        if (!thing) continue;
        if ("handle" in thing) gl.deleteTexture(thing.handle);
        if ("framebuffer" in thing) gl.deleteFramebuffer(thing.framebuffer);
        if ("vertices" in thing) gl.deleteVertexArray(thing.vertices);
        if ("buffers" in thing) thing.buffers.forEach((buffer) => gl.deleteBuffer(buffer));
      }
    },
  };
  return graphics;
}
