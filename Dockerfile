# Image of the commands: replay, calibrate, simulate, study. That of the ROS 2 node is ros2/Dockerfile.
#     docker build -t icreckon-cli .
#     docker run --rm -v "$PWD:/work" --user "$(id -u):$(id -g)" icreckon-cli demo
FROM python:3.12-slim

COPY pyproject.toml README.md LICENSE /opt/icreckon/source/
COPY estimator /opt/icreckon/source/estimator
COPY simulation /opt/icreckon/source/simulation
COPY replay /opt/icreckon/source/replay
COPY icreckon /opt/icreckon/source/icreckon

RUN python3 -m venv /opt/icreckon/venv \
    && /opt/icreckon/venv/bin/pip install --no-cache-dir /opt/icreckon/source

# What is compiled here is used on processors of the same kind; on others each start compiles.
ENV NUMBA_CACHE_DIR=/opt/icreckon/cache
RUN /opt/icreckon/venv/bin/icreckon prepare && chmod -R a+rwX "$NUMBA_CACHE_DIR"

# A user without an entry in the image has no home, where matplotlib would keep its cache of fonts.
ENV MPLCONFIGDIR=/tmp
WORKDIR /work
ENTRYPOINT ["/opt/icreckon/venv/bin/icreckon"]
CMD ["--help"]
