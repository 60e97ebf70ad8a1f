# The deployment side without a screen: robot server, sessions, recordings. Neither torch nor training.
#
#   docker build -t skewmi .
#   docker run --rm --network host --cap-add SYS_NICE --ulimit rtprio=99 skewmi robot --backend sim
#   docker run --rm --network host --cap-add SYS_NICE --ulimit rtprio=99 skewmi \
#       deploy open_press_close --connect tcp/127.0.0.1:7447
#
# The same Python as constraints/deploy.txt was made with. For films add libegl1 and libgl1-mesa-dri.
FROM python:3.11-slim

WORKDIR /opt/skewmi
COPY pyproject.toml README.md LICENSE ./
COPY constraints/deploy.txt constraints/deploy.txt
COPY skewmi skewmi
RUN pip install --no-cache-dir -c constraints/deploy.txt ".[security]" \
    && useradd --create-home skewmi

USER skewmi
WORKDIR /home/skewmi
EXPOSE 7447
ENTRYPOINT ["skewmi"]
CMD ["doctor"]
