# The relay: base install, no numpy, no OpenGL, not root. Build from the repository's root:
#     docker build -f docker/relay.Dockerfile -t pica-relay .
FROM python:3.11-slim
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt /src && rm -rf /src
RUN useradd --system --no-create-home pica
USER pica
EXPOSE 8765
HEALTHCHECK --interval=10s --timeout=3s CMD ["python", "-c", \
    "import urllib.request as u; u.urlopen('http://127.0.0.1:8765/healthz', timeout=2)"]
# --insecure: whoever reaches the port may join. Publish it to a network that you trust, only.
CMD ["pica", "relay", "--host", "0.0.0.0", "--port", "8765", "--insecure"]
