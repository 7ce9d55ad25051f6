# One image; every service of docker-compose.yml is a subcommand of its one command.
FROM python:3.11-slim AS build
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY api api
COPY estimation estimation
COPY fleet_db fleet_db
COPY ingest ingest
RUN python -m venv /opt/treadwatch \
    && /opt/treadwatch/bin/pip install --no-cache-dir --disable-pip-version-check --constraint constraints.txt '.[otel,dask,kafka,s3]'

# numba keeps the machine code of what runs, so that a container whose file system cannot be written need not compile
ENV TREADWATCH_COMPILED_DIR=/opt/treadwatch/compiled TREADWATCH_COMPILED_CPU=portable
RUN /opt/treadwatch/bin/treadwatch demo --once --scenario mems --folder /tmp/demo && rm -r /tmp/demo

FROM python:3.11-slim
RUN useradd --system --uid 10001 --home-dir /var/lib/treadwatch --create-home treadwatch \
    && mkdir /var/lib/treadwatch/data /var/lib/treadwatch/registry \
    && chown -R treadwatch:treadwatch /var/lib/treadwatch
COPY --from=build /opt/treadwatch /opt/treadwatch
ENV PATH=/opt/treadwatch/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    TREADWATCH_COMPILED_DIR=/opt/treadwatch/compiled \
    TREADWATCH_COMPILED_CPU=portable \
    TREADWATCH_DATA_DIR=/var/lib/treadwatch/data \
    TREADWATCH_LOG_FORMAT=json
USER treadwatch
WORKDIR /var/lib/treadwatch
EXPOSE 8000
ENTRYPOINT ["treadwatch"]
CMD ["--help"]
