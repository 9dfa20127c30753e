"""The panels of a call. Each is a function of what there is to show; see `call_view.Panel`."""
