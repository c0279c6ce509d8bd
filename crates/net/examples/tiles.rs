fn main() {
    handcast_net::tiles();
}
