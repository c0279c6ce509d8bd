//! The bytes of a connection: as they are, or by TLS.

use std::io::{self, Read};

use mio::net::TcpStream;

/// A socket, and how what goes over it is encrypted. What is to be written is handed to the socket by the one who asks, so that
/// nothing waits in here.
pub(super) struct Link {
    socket: TcpStream,
    #[cfg(feature = "tls")]
    tls: Option<Box<rustls::ServerConnection>>,
}

impl Link {
    pub fn new(socket: TcpStream) -> Self {
        Self {
            socket,
            #[cfg(feature = "tls")]
            tls: None,
        }
    }

    #[cfg(feature = "tls")]
    pub fn with_tls(self, tls: rustls::ServerConnection) -> Self {
        Self { tls: Some(Box::new(tls)), ..self }
    }

    pub fn socket(&mut self) -> &mut TcpStream {
        &mut self.socket
    }

    /// Asks the kernel to keep so many bytes of what is sent.
    pub fn keep(&mut self, bytes: usize) {
        // What it keeps otherwise does, too.
        let _ = socket2::SockRef::from(&self.socket).set_send_buffer_size(bytes);
    }

    /// Reads what has come, nothing at the end; what TLS answers by itself is added to `out`.
    ///
    /// # Errors
    /// The connection is broken, breaks the rules of TLS, or there is nothing for the moment.
    pub fn read(&mut self, buffer: &mut [u8], out: &mut Vec<u8>) -> io::Result<usize> {
        #[cfg(feature = "tls")]
        if let Some(tls) = &mut self.tls {
            return read_sealed(tls, &mut self.socket, buffer, out);
        }
        let _ = out;
        self.socket.read(buffer)
    }

    /// Adds bytes to `out` as they go over the socket.
    ///
    /// # Errors
    /// The connection is at its end.
    pub fn seal(&mut self, bytes: &[u8], out: &mut Vec<u8>) -> io::Result<()> {
        #[cfg(feature = "tls")]
        if let Some(tls) = &mut self.tls {
            return seal(tls, bytes, out);
        }
        out.extend(bytes);
        Ok(())
    }

    /// Adds to `out` what says that all has been said; nothing the second time.
    ///
    /// # Errors
    /// The connection is at its end.
    pub fn seal_end(&mut self, out: &mut Vec<u8>) -> io::Result<()> {
        #[cfg(feature = "tls")]
        if let Some(tls) = &mut self.tls {
            tls.send_close_notify();
            take(tls, out)?;
        }
        let _ = out;
        Ok(())
    }
}

/// Takes what is encrypted.
#[cfg(feature = "tls")]
fn take(tls: &mut rustls::ServerConnection, out: &mut Vec<u8>) -> io::Result<()> {
    while tls.wants_write() {
        tls.write_tls(out)?;
    }
    Ok(())
}

#[cfg(feature = "tls")]
fn seal(tls: &mut rustls::ServerConnection, mut bytes: &[u8], out: &mut Vec<u8>) -> io::Result<()> {
    use std::io::Write;
    while !bytes.is_empty() {
        let count = tls.writer().write(bytes)?;
        take(tls, out)?;
        bytes = bytes.get(count..).filter(|_| count > 0).ok_or(io::ErrorKind::WriteZero)?;
    }
    Ok(())
}

#[cfg(feature = "tls")]
fn read_sealed(
    tls: &mut rustls::ServerConnection,
    socket: &mut TcpStream,
    buffer: &mut [u8],
    out: &mut Vec<u8>,
) -> io::Result<usize> {
    loop {
        match tls.reader().read(buffer) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            // An end that TLS was not told, either.
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(0),
            read => return read,
        }
        tls.read_tls(socket)?;
        let processed = tls.process_new_packets();
        // A handshake goes on, or the other side is told what is wrong.
        take(tls, out)?;
        processed.map_err(io::Error::other)?;
    }
}
