# syntax=docker/dockerfile:1.7
#
#   docker build -t panoloc .                               CPU
#   docker build -t panoloc:cuda --build-arg DEVICE=cuda .   NVIDIA GPU
#
# Packages have the versions and digests of requirements/ (Linux on x86-64, Python 3.11; scripts/lock). The CPU image has the locked
# CPU build of PyTorch. Another one is named with --build-arg TORCH=...; for CUDA pip chooses the newest that fits.
# Where pip finds all of it is a matter of its configuration, which is never part of the image: pass one with
#   --secret id=pip_config,src=pip.conf
# and where npm's packages come from one of npm's: --secret id=npm_config,src=.npmrc
# The build stops when what came does not fit DEVICE. docs/operations.md says more.

ARG PYTHON_IMAGE=python:3.11-slim-bookworm

FROM ${PYTHON_IMAGE} AS console
WORKDIR /src
COPY requirements ./requirements
RUN --mount=type=secret,id=pip_config,target=/etc/pip.conf \
    python -m venv .venv && .venv/bin/pip install --no-cache-dir --require-hashes --no-deps -r requirements/console.txt
COPY scripts/build-console ./scripts/build-console
COPY service/console ./service/console
RUN --mount=type=secret,id=npm_config,target=/root/.npmrc scripts/build-console

FROM ${PYTHON_IMAGE} AS build
ARG DEVICE=cpu
ARG TORCH=
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
RUN python -m venv /opt/panoloc
ENV PATH=/opt/panoloc/bin:$PATH
WORKDIR /src

# The dependencies change rarely and are large, so they get a layer before the code.
COPY requirements ./requirements
RUN --mount=type=secret,id=pip_config,target=/etc/pip.conf \
    if [ -n "${TORCH}" ]; then pip install "${TORCH}"; \
    elif [ "${DEVICE}" = cuda ]; then pip install "torch>=2.6,<2.14"; \
    else pip install --require-hashes --no-deps -r requirements/torch.txt \
    || { echo "expected pip to find the CPU build of PyTorch; name its index: --secret id=pip_config,src=pip.conf" >&2; exit 1; }; fi \
    && pip install --require-hashes --no-deps -r requirements/service.txt
COPY docker/check_torch_build.py ./
RUN python check_torch_build.py "${DEVICE}"

COPY pyproject.toml README.md LICENSE ./
COPY core ./core
COPY lab ./lab
COPY service ./service
COPY --from=console /src/service/console/built ./service/console/built
RUN --mount=type=secret,id=pip_config,target=/etc/pip.conf pip install --no-deps --no-build-isolation .

FROM ${PYTHON_IMAGE}
ARG DEVICE=cpu
LABEL org.opencontainers.image.title="panoloc" \
      org.opencontainers.image.description="Finds where a 360° photo was taken inside a scanned place" \
      org.opencontainers.image.licenses="Apache-2.0" \
      panoloc.device="${DEVICE}"
# Open3D loads these; tini ends what a killed worker leaves behind.
RUN apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0 libgomp1 tini \
    && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --create-home --home-dir /home/panoloc panoloc \
    && install -d -o panoloc -g panoloc /data
COPY --from=build /opt/panoloc /opt/panoloc
ENV PATH=/opt/panoloc/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    PANOLOC_HOST=0.0.0.0 \
    PANOLOC_PORT=8000 \
    PANOLOC_DATA_DIR=/data \
    PANOLOC_LOG_FORMAT=json \
    NVIDIA_VISIBLE_DEVICES=all \
    NVIDIA_DRIVER_CAPABILITIES=compute,utility
USER 10001:10001
WORKDIR /home/panoloc
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=120s --retries=3 \
    CMD ["python", "-c", "import os, urllib.request; urllib.request.urlopen('http://127.0.0.1:' + os.environ['PANOLOC_PORT'] + '/health/ready', timeout=4)"]
STOPSIGNAL SIGTERM
ENTRYPOINT ["tini", "--"]
CMD ["panoloc", "serve"]
