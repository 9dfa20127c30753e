# The relay: no numpy, no OpenGL, no compiler, not root. Build from the repository's root:
#     docker build -f docker/relay.Dockerfile -t pica-relay .
# Run it with a key file (docs/operating.md), as the user who may read it; it refuses to start without:
#     docker run --user $(id -u):$(id -g) --read-only --tmpfs /tmp -p 8765:8765 \
#         -v $PWD/keys:/run/secrets/keys:ro -e PICA_RELAY_KEYS=/run/secrets/keys pica-relay
FROM python:3.11.13-slim-bookworm@sha256:86adf8dbadc3d6e82ee5dd2c74bec2e1c2467cdad47886280501df722372d2e1 AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY command command
COPY protocol protocol
COPY server server
COPY pica_core pica_core
COPY client client
RUN python -m venv /opt/pica \
    && /opt/pica/bin/pip install --no-cache-dir --constraint constraints.txt '.[cluster]'

FROM python:3.11.13-slim-bookworm@sha256:86adf8dbadc3d6e82ee5dd2c74bec2e1c2467cdad47886280501df722372d2e1
COPY --from=build /opt/pica /opt/pica
COPY docker/healthcheck.py /opt/pica/healthcheck.py
ENV PATH=/opt/pica/bin:$PATH PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 \
    PICA_RELAY_HOST=0.0.0.0 PICA_RELAY_PORT=8765 PICA_RELAY_LOG=json
# By number, so that Kubernetes can see that it is not root.
USER 10001:10001
EXPOSE 8765
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=10s --timeout=3s --start-period=5s CMD ["python", "/opt/pica/healthcheck.py"]
ENTRYPOINT ["pica"]
CMD ["relay"]
