"""The baseline's decoder as an ONNX graph.

baseline_graph(baseline)    latent [1, 256], view_direction [1, 3]
                            -> vertices [V, 3] metres, texture [1024, 1024, 3]
"""

from pica_core.avatar.spec import LEAKY_SLOPE, RGB_CHANNELS, VIEW_CHANNELS
from pica_core.graphs.graph_builder import GraphBuilder
from pica_core.reference.baseline import FIRST_SIZE, BaselineAvatar


def baseline_graph(baseline: BaselineAvatar) -> bytes:
    """The decoder with its layers as they stand, one operator each.

    Fully connected layers are Gemms with the weights as they stand; convolutions are transposed
    convolutions with an Add for the untied bias.

    Returns:
        Serialised model, float32; the texture is sRGB with 1.0 white, row 0 is v = 0, not clamped.
    """
    graph, spec, tensors = GraphBuilder(), baseline.spec, baseline.tensors

    def connect(name: str, value: str, output: str | None = None) -> str:
        weight, bias = (graph.floats(tensors[f"{name}.{part}"]) for part in ("weight", "bias"))
        return graph.add("Gemm", value, weight, bias, transB=1, output=output)

    def leaky(value: str) -> str:
        return graph.add("LeakyRelu", value, alpha=LEAKY_SLOPE)

    code = leaky(connect("latent", "latent"))
    vertices = connect("mesh", code)
    shape = graph.sizes(spec.num_vertices, 3)
    graph.add("Reshape", vertices, shape, output="vertices")
    view = leaky(connect("view", "view_direction"))
    value = leaky(connect("grid", graph.add("Concat", code, view, axis=1)))
    shape = graph.sizes(1, spec.num_latent, FIRST_SIZE, FIRST_SIZE)
    value = graph.add("Reshape", value, shape)
    for index in range(len(spec.channels)):
        weight = graph.floats(tensors[f"texture.{index}.weight"])
        value = graph.add("ConvTranspose", value, weight, strides=[2, 2], pads=[1] * 4)
        value = graph.add("Add", value, graph.floats(tensors[f"texture.{index}.bias"][None]))
        if index + 1 < len(spec.channels):
            value = leaky(value)
    size = spec.texture_size
    last = graph.add("Transpose", value, perm=[0, 2, 3, 1])
    graph.add("Reshape", last, graph.sizes(size, size, RGB_CHANNELS), output="texture")
    return graph.serialise(
        {"latent": [1, spec.num_latent], "view_direction": [1, VIEW_CHANNELS]},
        {
            "vertices": [spec.num_vertices, 3],
            "texture": [size, size, RGB_CHANNELS],
        },
    )
