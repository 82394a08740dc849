# liaam with its extras for videos and tables, for computers where nothing may be installed:
#
#     docker build --tag liaam .
#     docker run --rm --volume "$PWD:/data" --user "$(id -u):$(id -g)" liaam fit photo.jpg
FROM python:3.13-slim AS build
RUN apt-get update && apt-get install --yes --no-install-recommends g++ && rm -rf /var/lib/apt/lists/*
COPY . /liaam
RUN LIAAM_REQUIRE_CORE=1 pip wheel --no-cache-dir --no-deps --wheel-dir /wheels /liaam

FROM python:3.13-slim
COPY --from=build /wheels /wheels
RUN wheel="$(echo /wheels/liaam-*.whl)" && pip install --no-cache-dir "${wheel}[video,batch,pandas]"
ENV HOME=/tmp MPLBACKEND=Agg
WORKDIR /data
ENTRYPOINT ["liaam"]
CMD ["--help"]
