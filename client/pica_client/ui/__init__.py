"""The window of a call: texts over the picture, controls, preferences."""
