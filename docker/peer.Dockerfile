# Sender and headless viewer with software OpenGL (Mesa). Build from the repository's root:
#     docker build -f docker/peer.Dockerfile -t pica-peer .
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends \
    libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri && rm -rf /var/lib/apt/lists/*
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt '/src[view,video]' && rm -rf /src
RUN useradd --system --create-home pica && mkdir /out && chown pica /out
USER pica
ENTRYPOINT ["pica"]
CMD ["doctor"]
