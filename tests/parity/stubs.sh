# Empty libraries in place of CUDA's, so that PyPI's wheel of torch loads on a machine without them: `stubs.sh VENV`.
set -e
folder=$(echo "$1"/lib/python3*/site-packages/torch/lib)
work=$(mktemp -d)
for name in libcusparse.so.12 libcufft.so.11 libcufile.so.0 libcusparseLt.so.0 libcurand.so.10 libcublas.so.12 \
            libcublasLt.so.12 libcudnn.so.9 libnccl.so.2; do
    readelf --dyn-syms -W "$folder"/*.so | sed -n "s/.* UND \(.*\)@$name.*/void \1(void){}/p" | sort -u > "$work/stub.c"
    echo "$name { global: *; };" > "$work/stub.map"
    gcc -shared -fPIC -o "$folder/$name" -Wl,-soname,"$name" -Wl,--version-script="$work/stub.map" "$work/stub.c"
done
rm -r "$work"
