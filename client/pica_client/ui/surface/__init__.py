"""The surface of the window on Dear ImGui: input, fonts, style, widgets, and its way to the GPU."""
