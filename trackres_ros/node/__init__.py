"""The running application: messages in, torques and statuses out, in time. Knows no transport; `ros` and `dds` are its two."""
