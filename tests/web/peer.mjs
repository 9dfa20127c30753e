// Runs the page's modules for tests/web: one request a line, [name, arguments], one answer a line.
// Bytes are {"hex": "…"}; numbers that JSON lacks do not occur.
import { createInterface } from "node:readline";

const web = new URL("../../server/pica_server/web/", import.meta.url);
// Node has no half floats yet.
globalThis.Float16Array ??= class extends Float32Array {
  static BYTES_PER_ELEMENT = 2;

  constructor(buffer) {
    super(Array.from(new Uint16Array(buffer), (bits) => {
      const [exponent, fraction] = [(bits >> 10) & 31, bits & 1023];
      return (bits & 0x8000 ? -1 : 1) * (exponent ? 2 ** (exponent - 25) * (1024 + fraction) : 2 ** -24 * fraction);
    }));
  }
};

const modules = {};
const objects = [];

function read(value) {
  if (Array.isArray(value)) return value.map(read);
  if (value === null || typeof value !== "object") return value;
  if ("hex" in value) return Uint8Array.from(Buffer.from(value.hex, "hex"));
  if ("object" in value) return objects[value.object];
  if ("constant" in value) return () => value.constant;
  if ("lookup" in value) {
    const found = read({ map: value.lookup });
    return (name) => found.get(name);
  }
  if ("map" in value) return new Map(Object.entries(read(value.map)));
  if ("f32" in value) return Float32Array.from(value.f32);
  return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, read(item)]));
}

function write(value) {
  if (value instanceof Uint8Array) return { hex: Buffer.from(value).toString("hex") };
  if (ArrayBuffer.isView(value)) return Array.from(value);
  if (Array.isArray(value)) return value.map(write);
  if (value === undefined) return null;
  if (typeof value === "function") return { object: objects.push(value) - 1 };
  if (value === null || typeof value !== "object") return value;
  if (![Object.prototype, null].includes(Object.getPrototypeOf(value))) {
    return { object: objects.push(value) - 1 };
  }
  return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, write(item)]));
}

async function answer([target, name, args]) {
  if (typeof target !== "string") {
    const object = read(target);
    const member = object[name];
    return typeof member === "function" ? member.apply(object, read(args)) : member;
  }
  const module = (modules[target] ??= await import(new URL(target, web)));
  const member = module[name];
  const isClass = /^class\b/.test(String(member));
  return isClass ? new member(...read(args)) : typeof member === "function" ? member(...read(args)) : member;
}

for await (const line of createInterface({ input: process.stdin })) {
  try {
    console.log(JSON.stringify({ value: write(await answer(JSON.parse(line))) }));
  } catch (error) {
    console.log(JSON.stringify({ error: `${error?.constructor?.name}: ${error?.message}` }));
  }
}
