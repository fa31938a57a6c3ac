#   docker build -t panoloc .                                      CPU
#   docker build -t panoloc:cuda --build-arg DEVICE=cuda .          NVIDIA GPU
#   docker build -t panoloc:ray --build-arg RAY=true .              with the extra for workers on several machines
#
# requirements/ locks the version and digest of every package (Linux on x86-64, Python 3.11). The CPU image has the locked CPU build of
# PyTorch; --build-arg TORCH=... names another one. For CUDA, pip chooses the newest that fits.
# Your network: put certificates of your own authority into docker/certificates as .crt files. The build and the image trust them. Pass
# pip's configuration with --secret id=pip_config,src=pip.conf and npm's with --secret id=npm_config,src=.npmrc; neither stays in the image.
# docs/operations.md says more.

ARG PYTHON_IMAGE=python:3.11-slim-bookworm

FROM ${PYTHON_IMAGE} AS base
COPY docker/certificates/ /usr/local/share/ca-certificates/
RUN update-ca-certificates
# The libraries that TLS is used by bring certificates of their own; these variables name Debian's, which hold the ones from above.
ENV SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt \
    REQUESTS_CA_BUNDLE=/etc/ssl/certs/ca-certificates.crt

FROM base AS console
ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt \
    NODE_EXTRA_CA_CERTS=/etc/ssl/certs/ca-certificates.crt
WORKDIR /src
COPY requirements/console.txt ./requirements/
COPY scripts/build-console ./scripts/
RUN --mount=type=secret,id=pip_config,target=/etc/pip.conf python3 -m venv .venv \
    && .venv/bin/pip install --no-cache-dir --require-hashes --no-deps -r requirements/console.txt
COPY clients/js/src ./clients/js/src
COPY service/console ./service/console
RUN --mount=type=secret,id=npm_config,target=/root/.npmrc scripts/build-console

FROM base AS build
ARG DEVICE=cpu
ARG RAY=false
ARG TORCH=
ENV PIP_CERT=/etc/ssl/certs/ca-certificates.crt PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1
RUN python3 -m venv /opt/panoloc
ENV PATH=/opt/panoloc/bin:$PATH
WORKDIR /src

# The dependencies change rarely and are large, so they get a layer before the code.
COPY requirements ./requirements
RUN --mount=type=secret,id=pip_config,target=/etc/pip.conf \
    if [ -n "${TORCH}" ]; then pip install "${TORCH}"; \
    elif [ "${DEVICE}" = cuda ]; then pip install "torch>=2.6,<2.14"; \
    else pip install --require-hashes --no-deps -r requirements/torch.txt \
    || { echo "expected pip to find the CPU build of PyTorch; name its index: --secret id=pip_config,src=pip.conf" >&2; exit 1; }; fi \
    && pip install --require-hashes --no-deps -r requirements/service.txt \
    && if [ "${RAY}" = true ]; then pip install --require-hashes --no-deps -r requirements/ray.txt; fi
COPY docker/check_torch_build.py ./
RUN python check_torch_build.py "${DEVICE}"

COPY pyproject.toml setup.py README.md LICENSE ./
COPY panoloc ./panoloc
COPY core ./core
COPY lab ./lab
COPY clients ./clients
COPY service ./service
COPY --from=console /src/service/console/built ./service/console/built
# The compiler of the kernels; it does not get into the image.
RUN apt-get update && apt-get install -y --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
RUN pip install --no-deps --no-build-isolation .
# PyTorch's own tests and C++ headers are of no use here: 180 MB.
RUN cd /opt/panoloc/lib/python3*/site-packages/torch && rm -rf test include && find bin -type f ! -name torch_shm_manager -delete

FROM base
ARG DEVICE=cpu
LABEL org.opencontainers.image.title="panoloc" \
      org.opencontainers.image.description="Finds where a 360° photo was taken inside a scanned place" \
      org.opencontainers.image.licenses="Apache-2.0" \
      panoloc.device="${DEVICE}"
# Open3D loads these; tini reaps what a killed worker leaves behind. Nothing is drawn, so the drivers behind OpenGL stay out: 170 MB.
RUN printf 'path-exclude=/usr/lib/*/%s\n' 'dri/*' 'libLLVM*' 'libz3*' >/etc/dpkg/dpkg.cfg.d/no-drivers \
    && apt-get update \
    && apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0 libgomp1 tini \
    && rm -rf /var/lib/apt/lists/* /var/cache/apt/* \
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
