#!/bin/sh
# Makes cert.pem and key.pem anew, which the tests of TLS serve with: for localhost, signed by itself, from 2020 to 2120.
set -e
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -r "$work"' EXIT
: > "$work/index"
cat > "$work/conf" <<END
[ca]
default_ca = own
[own]
database = $work/index
new_certs_dir = $work
rand_serial = yes
default_md = sha256
policy = names
x509_extensions = more
[names]
commonName = supplied
[more]
subjectAltName = DNS:localhost
basicConstraints = critical,CA:FALSE
END
openssl req -new -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -subj /CN=localhost -keyout key.pem -out "$work/request"
openssl ca -batch -notext -selfsign -config "$work/conf" -keyfile key.pem -in "$work/request" -out cert.pem \
    -startdate 20200101000000Z -enddate 21200101000000Z
