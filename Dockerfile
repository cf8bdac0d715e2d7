# docker build -t softdeca .        set-up, once
# docker run softdeca               make study: out/study in the container (-v "$PWD/out:/softdeca/out" keeps it)
# docker run softdeca make test     the tests
FROM debian:12
RUN apt-get update && apt-get install -y --no-install-recommends git make
COPY . /softdeca
WORKDIR /softdeca
RUN make setup
CMD ["make", "study"]
