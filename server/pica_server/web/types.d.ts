// Types that the modules of the page share: for the compiler alone, and never served.

// Space

type Vector = [number, number, number];
/** 16 numbers, row by row. */
type Matrix = Float64Array;
interface Camera {
  centre: Vector;
  /** Right, up and forward in the world. */
  axes: [Vector, Vector, Vector];
  /** Slopes of the picture's edges: left, bottom, right, top. */
  lens: [number, number, number, number];
  width: number;
  height: number;
}

// The wire

type Track = { kind: string; avatar: string; stream: number; deadline_ms: number };
type Peer = { peer_id: string; name: string; tracks: Track[]; metadata: Record<string, string> };
type Frame = { stream: number; sequence: number; capturedUs: number; payload: Uint8Array };
type Message = { type: string; [field: string]: any };
type Join = { room: string; name: string; token: string; tracks: Track[] };
/** Where everything goes that a link hears. */
interface LinkHandler {
  message(message: Message): void;
  frame(frame: Frame): void;
  left(state: "joining" | "reconnecting" | "ended", reason: string): void;
}
type Bytes = Uint8Array<ArrayBuffer>;
type FrameKey = { id: number; cipher: CryptoKey; salt: Bytes };
type SealState = "waiting" | "verified" | "plain" | "secret differs" | "relabelled";
type Way = [sender: string, receiver: string];

// Faces

/**
 * A face at one moment. Its 262 values: the latent (8 rows, 8 columns, 4 channels), the rotation
 * from head to seat (a rotation vector, radians) and the translation (metres). Still: nothing
 * changes until the next one.
 */
type Sample = { values: Float32Array; isStill: boolean };
/** What is shown of a face, and how fresh that is. */
type Face = { values: Float32Array; status: "live" | "stale" | "away" };
type SendFace = (payload: Uint8Array, capturedUs: number, multiple: number) => void;
type Person = import("./call.js").Member;

// Avatar files

type Avatar = import("./avatar.js").Avatar;
type Entry = { dtype: string; shape: number[]; start: number; end: number };
type Affine = { scale: number[]; offset: number[] };
interface Manifest {
  position_scale_m: number;
  bounds_min_m: Vector;
  bounds_max_m: Vector;
  /** Least and most yaw, least and most pitch, degrees. */
  view_span: number[];
}

// Graphics

type Format =
  "RGBA8" | "RGBA16F" | "RGBA32F" | "RG16F" | "RG32F" | "RGB8" | "RGB32F" | "RGB16UI" | "DEPTH";
/** What stands for a name in a shader; null: a whole number that each draw tells. */
type Defines = Record<string, string | number | null>;
type Setters = Record<string, (value: any) => void>;
type Texture =
  { handle: WebGLTexture; kind: number; width: number; height: number; format: Format };
/** One that begins empty with each image has the number of the image. */
type Target = { framebuffer: WebGLFramebuffer | null; width: number; height: number;
  number?: number };
type Program = { handle: WebGLProgram; set: Setters | null; key: string };
type Triangles = { vertices: WebGLVertexArrayObject; count: number; buffers: WebGLBuffer[] };
interface Graphics {
  gl: WebGL2RenderingContext;
  /** For what is between two passes, in four channels and in two; and for what is filtered. */
  exact: Format;
  pairs: Format;
  smooth: Format;
  /** Whether the processor draws. */
  isSoftware: boolean;
  /** Two shaders, composed and compiled once; `generated` is included as `siren.glsl`. */
  program(vertex: string, fragment: string, defines?: Defines, generated?: string): Program;
  /** A program that covers a rectangle. */
  screen(fragment: string, defines?: Defines, generated?: string): Program;
  forget(program: Program): void;
  /** Draw into it from now on. */
  into(target: Target): void;
  /** Take a program, and what its uniforms are. */
  use(program: Program, uniforms: Record<string, any>): void;
  /** Draw a rectangle. */
  draw(program: Program, target: Target, uniforms: Record<string, any>): void;
  drawMesh(
    program: Program, mesh: Triangles, uniforms: Record<string, any>, copies?: number): void;
  /** A texture, or an array of one. */
  texture(format: Format, width: number, height: number,
    options?: { smooth?: boolean; levels?: number; isArray?: boolean }): Texture;
  /** Fill a texture. */
  write(texture: Texture, data: ArrayBufferView): Texture;
  /** What draws into textures. */
  target(colours: Texture[], depth?: Texture): Target;
  /** Triangles of vertices that have these numbers each. */
  triangles(faces: Uint32Array, corners: Float32Array, layout: [string, number][]): Triangles;
  free(...things: (Texture | Target | Triangles | null | undefined)[]): void;
}

// Decoding

type Pass = { program: string; numbers: Record<string, number>; columns: number; rows: number;
  table: "half" | "exact" };
type Numbers = { format: Format; width: number; height: number; data: ArrayBufferView };
/** The trunk is parted where levels leave it. */
type Plan = { trunk: Pass[][]; exits: Pass[]; full: Pass; vertices: Pass[] };
type Decoder = ReturnType<typeof import("./decode.js").openDecoder>;
/** One head to decode: the camera as its head sees it, of length 1, and where its vertices go, null
 * to keep them, and its expression map. */
type Job = { avatar: Avatar; latent: Float32Array; view: ArrayLike<number>; level: number;
  positions: Target | null; codes: Target };

// Drawing

/** Left, bottom, right, top in pixels, rows from the bottom. */
type Rect = [number, number, number, number];
type MeshPrograms = { surface: Program; static: Program; unwrap: Program };
type AvatarBody = ReturnType<typeof import("./head.js").openBody>;
type Layer = ReturnType<typeof import("./draw.js").openLayer>;
/** A head with its avatar, and what was drawn of it in each view. */
type Maps = ReturnType<typeof import("./head.js").openMaps>;
type Look = { avatar: Avatar; body: AvatarBody; maps: Maps; layers: Layer[]; version: number;
  free(): void };
/** A head of a frame: from its frame to the world, how far it has faded into the room, and its
 * share of the resolution. */
type Placement = { look: Look; matrix: Matrix; fade: number; scale: number };
type View = { camera: Camera; rect: Rect; placements: Placement[] };
type Room = { places: Vector[]; speaking: number[] };
type DecodeRequest = { look: Look; latent: Float32Array; view: ArrayLike<number>; level: number;
  isBoth: boolean };
type Shown = { placement: Placement; index: number; matrix: Matrix; view: Rect; rect: Rect;
  key: string; layer: Layer };
type Renderer = ReturnType<typeof import("./draw.js").openRenderer>;

// What heads get

type Decode = "none" | "expression" | "both";
/** Pixels that nearer heads do not hide; the head's height. */
type Sight = { visiblePx: number; headPx: number };
type Choice = { level: number; decode: Decode; scale: number; every: number };
/** Seconds of a frame, of a triangle and of a pixel; of a decode. */
type Costs = { draw: number[]; decodeS(level: number, decode: Decode): number };

// Seats

type Layout = "line" | "table" | "grid";
type Seen = { camera: Vector; target: Vector };
type SeatPlan = Seen & { seats: Matrix[] };
/** Radians about the middle of the seats. */
type Orbit = { yaw: number; pitch: number; zoom: number };
/** Tangents, y up. */
type Tangents = { left: number; right: number; bottom: number; top: number };
type Arrangement = { places: Vector[]; pitch?: number; faced?: Vector };
type Arrange = (count: number, view: Tangents, spacing: number) => Arrangement;

// The page

type Call = import("./call.js").Call;
type Picture = import("./scene.js").Picture;

/** What the user wants to see. */
interface Wanted {
  layout: Layout;
  /** The id of the one who fills the picture; empty for none. */
  pinned: string;
  orbit: Orbit;
  /** The part of the height below that is kept free. */
  free: number;
  /** Whom the small picture at the lower left shows, and how far above the border that is. */
  self: Person | null;
  rise: number;
  /** Whether people take their seats at once. */
  isCalm: boolean;
}
/** A participant, and left, top, right, bottom of where they may be, pixels. */
type Label = { person: Person; rect: number[] | null; hasFace: boolean };
