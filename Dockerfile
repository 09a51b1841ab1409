# docker build -t kinfeas . && docker run kinfeas
FROM python:3.11-slim
RUN apt-get update && apt-get install -y --no-install-recommends build-essential git && rm -rf /var/lib/apt/lists/*
WORKDIR /kinfeas
COPY . .
RUN make .venv/.installed-demo
CMD ["make", "demo"]
