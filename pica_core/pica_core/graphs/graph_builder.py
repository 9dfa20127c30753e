"""A small builder of ONNX models: nodes and constants in the order in which they are added."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 17
"""Newer operator sets lack ONNX Runtime's fused CPU kernels for some of what we use."""
IR_VERSION = 8

Shape = list[int | str]


@dataclass(slots=True)
class GraphBuilder:
    """Nodes and initialisers under construction. Values are named by the node that makes them."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    initialisers: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, array: npt.ArrayLike) -> str:
        """A constant of the array's own type."""
        name = f"constant_{len(self.initialisers)}"
        values = np.ascontiguousarray(array)
        self.initialisers.append(numpy_helper.from_array(values, name))
        return name

    def floats(self, array: npt.ArrayLike) -> str:
        """A constant in float32."""
        return self.constant(np.asarray(array, np.float32))

    def sizes(self, *sizes: int) -> str:
        """A constant list of int64, as shapes and axes are."""
        return self.constant(np.array(sizes, np.int64))

    def add(self, operator: str, *inputs: str, output: str | None = None, **attributes: Any) -> str:
        """Add a node with one output and return that value's name."""
        name = f"{operator}_{len(self.nodes)}"
        made = output or f"{name}_out"
        self.nodes.append(helper.make_node(operator, inputs, [made], name=name, **attributes))
        return made

    def serialise(self, inputs: dict[str, Shape], outputs: dict[str, Shape]) -> bytes:
        """The model with float32 inputs and outputs of these names and shapes."""

        def infos(shapes: dict[str, Shape]) -> list[onnx.ValueInfoProto]:
            return [
                helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
                for name, shape in shapes.items()
            ]

        graph = helper.make_graph(
            self.nodes, "pica", infos(inputs), infos(outputs), self.initialisers
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
        )
        serialised: bytes = model.SerializeToString()
        return serialised
