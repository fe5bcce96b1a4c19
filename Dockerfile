# fidpipe in a container; the steps are tried by `make release-check`, without docker.
#   docker build --tag fidpipe .
#   docker run --rm --network none --user "$(id -u):$(id -g)" --volume "$PWD:/work" fidpipe run dataset/
FROM python:3.13-slim AS build
COPY . /build
WORKDIR /build
RUN python -m venv /opt/build
RUN /opt/build/bin/pip install --no-cache-dir --require-hashes --requirement requirements.lock
RUN /opt/build/bin/python -m build --wheel --no-isolation --outdir /build/dist
RUN python -m venv /opt/fidpipe
RUN /opt/fidpipe/bin/pip install --no-cache-dir --require-hashes --requirement requirements-run.lock
RUN /opt/fidpipe/bin/pip install --no-cache-dir --no-deps /build/dist/*.whl
RUN /opt/fidpipe/bin/pip check

FROM python:3.13-slim
COPY --from=build /opt/fidpipe /opt/fidpipe
ENV HOME=/tmp
ENV MPLBACKEND=agg
WORKDIR /work
USER 1000:1000
ENTRYPOINT ["/opt/fidpipe/bin/fidpipe"]
CMD ["--help"]
