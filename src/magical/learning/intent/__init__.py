"""What demonstrations were for: a posterior over programs of the language of goals."""
