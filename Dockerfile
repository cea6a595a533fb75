# The locked environment on Debian 12, ready for `carecontact run`:
#
#     make wheels
#     docker build -t carecontact .
#     docker run --rm -v "$PWD/runs:/work/runs" carecontact run --policy state-machine --out runs/script
#
# Make the wheels first (`make wheels`): the image holds the one of its platform, with the versions of uv.lock, and
# neither the sources nor a compiler.
FROM python:3.11-slim-bookworm AS build

ENV UV_COMPILE_BYTECODE=1 UV_LINK_MODE=copy
RUN pip install --no-cache-dir uv==0.13.8
WORKDIR /src
COPY pyproject.toml uv.lock ./
RUN uv export --frozen --quiet --no-dev --no-default-groups --no-emit-project --extra tables --extra figures \
        --output-file locked.txt \
    && uv venv /opt/carecontact \
    && uv pip install --python /opt/carecontact --requirement locked.txt
COPY dist/carecontact-*.whl dist/
RUN uv pip install --python /opt/carecontact --no-deps dist/carecontact-*-manylinux_2_17_"$(uname -m)".whl

FROM python:3.11-slim-bookworm

# What MuJoCo needs to render without a display.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/carecontact /opt/carecontact
# Policies must not run as root: its privileges would reach farther than the isolation of a policy's process allows for.
RUN useradd --create-home --uid 1000 carecontact && mkdir /work && chown carecontact /work
USER 1000
WORKDIR /work
ENV PATH=/opt/carecontact/bin:$PATH
ENTRYPOINT ["carecontact"]
CMD ["doctor"]
