"""Measurements of the client, each with cost and error; nothing in the product imports them."""
