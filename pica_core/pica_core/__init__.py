"""The avatar: its numbers, its file, its graphs. The base needs numpy only; torch stays in model/
and train/.
"""
