# The package with training and reports, from pinned versions:
#   docker build -t magical . && docker run --rm -v "$PWD:/work" magical envs
# With --build-arg PIP_EXTRA_INDEX_URL=... pip takes PyTorch's CPU build (docs/getting-started.md).
FROM python:3.12-slim
ARG PIP_EXTRA_INDEX_URL
WORKDIR /source
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY tools/install.py tools/
COPY src src
COPY baselines baselines
RUN python tools/install.py report baselines && useradd --create-home --uid 1000 user
USER 1000
WORKDIR /work
ENTRYPOINT ["magical"]
