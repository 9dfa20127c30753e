"""The one module that imports ONNX Runtime, with its telemetry switched off.

The official builds of ONNX Runtime 1.29 and later send usage events to their maker and keep an
identifier of the machine in the user's cache folder. Both are off when ``ORT_DISABLE_TELEMETRY`` is
1 before the library is first imported, so everybody imports it from here:

    from pica_client.decode.onnx_runtime import onnxruntime

Who sets the variable otherwise wins: ``ORT_DISABLE_TELEMETRY=0`` leaves the telemetry on.
"""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

import onnxruntime

__all__ = ["onnxruntime"]
