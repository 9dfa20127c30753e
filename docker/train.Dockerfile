# Captures, training and export with software OpenGL (Mesa), not root. Build from the repository's root:
#     docker build -f docker/train.Dockerfile -t pica-train .
# With a GPU: `docker run --gpus all`, and the wheels of torch that the constraints file pins.
#     docker run -v $PWD/runs:/runs pica-train capture person --out /runs/capture
FROM python:3.11.13-slim-bookworm@sha256:86adf8dbadc3d6e82ee5dd2c74bec2e1c2467cdad47886280501df722372d2e1
RUN apt-get update \
    && apt-get install -y --no-install-recommends libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY command command
COPY protocol protocol
COPY server server
COPY pica_core pica_core
COPY client client
RUN python -m venv /opt/pica \
    && /opt/pica/bin/pip install --no-cache-dir --constraint constraints.txt '.[train]' \
    && rm -rf /src/*
RUN useradd --uid 10001 --create-home pica && mkdir /runs && chown pica /runs
ENV PATH=/opt/pica/bin:$PATH PYTHONUNBUFFERED=1
WORKDIR /runs
USER 10001
ENTRYPOINT ["pica"]
CMD ["train", "--help"]
