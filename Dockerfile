# Pictures, films and numbers of the baselines: docker build --tag collaborative-gym .
# docker run --volume "$PWD/out:/gym/out" collaborative-gym
FROM python:3.12-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri \
    && rm -rf /var/lib/apt/lists/*
WORKDIR /gym
COPY . .
RUN pip install --no-cache-dir --constraint constraints.txt --editable ".[video,view]"
CMD ["collaborative-gym", "demo"]
